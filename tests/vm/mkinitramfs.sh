#!/bin/bash
# mkinitramfs.sh KERNEL_FOLDER OUT: busybox, spin.c, `init` and the modules that it loads.
# Not compressed: to unpack takes longer in the machine than to read more.
set -euo pipefail
PATH=$PATH:/usr/sbin:/sbin
folder=$1 out=$2 version=$(cat "$1/ready")
tree=$(mktemp -d)
trap 'rm -rf "$tree"' EXIT
mkdir -p "$tree"/{bin,dev,proc,sys,tmp,new,host,"lib/modules/$version"}
cp "$(command -v busybox)" "$tree/bin/busybox"
"${CC:-cc}" -std=c11 -O2 -static -nostdlib -fno-stack-protector "$(dirname "$0")/spin.c" -o "$tree/bin/spin"
for module in virtio_pci 9p 9pnet_virtio overlay uhid hid-generic usbhid evdev ff-memless vhci-hcd; do
    modprobe -d "$folder" -S "$version" --show-depends "$module" | awk '$1 == "insmod" {print $2}'
done | sort -u | while read -r file; do
    copy=$tree/lib/modules/$version/${file#*/lib/modules/"$version"/}
    mkdir -p "${copy%/*}"
    cp "$file" "$copy"
done
cp "$folder/lib/modules/$version/modules."{order,builtin,builtin.modinfo} "$tree/lib/modules/$version/"
depmod -b "$tree" "$version"
install -m 755 "$(dirname "$0")/init" "$tree/init"
(cd "$tree" && find . | cpio -o -H newc --quiet) >"$out.new"
mv "$out.new" "$out"
