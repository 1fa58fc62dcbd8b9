#!/bin/bash
# setup.sh: QEMU, Debian's kernels, ordinary and PREEMPT_RT, and udev, into $HAPTICD_VM (default ~/.cache/hapticd-vm),
# from where apt is configured to fetch. Run again it does nothing. Where it cannot be done it prints why, in one line, and
# ends with 77; the host keeps its own kernel.
set -euo pipefail
lab=${HAPTICD_VM:-$HOME/.cache/hapticd-vm}
said=$(mktemp)
trap 'rm -f "$said"' EXIT
skip() { echo "$*"; exit 77; }
why() { grep -h -m 1 '^E: ' "$said" || echo "apt-get failed"; }
apt() {
    $as_root env DEBIAN_FRONTEND=noninteractive apt-get -o DPkg::Lock::Timeout=120 -o Acquire::Retries=2 -qq "$@" \
        >"$said" 2>&1
}

[ "$(uname -m)" = x86_64 ] || skip "the virtual machine is an x86_64, this is $(uname -m)"
PATH=$PATH:/usr/sbin:/sbin
as_root= root=1
[ "$(id -u)" = 0 ] || { sudo -n true 2>/dev/null && as_root="sudo -n"; } || root=

# Root updates apt's lists once something is missing; others take them as they are.
listed=
lists() { # WHAT
    command -v apt-get >/dev/null || skip "no $1, and no apt-get to fetch it"
    [ -z "$listed" ] && [ -n "$root" ] || return 0
    apt update || skip "no $1, and apt's lists cannot be updated: $(why)"
    listed=1
}

packages=()
for need in qemu-system-x86_64:qemu-system-x86 busybox:busybox-static cpio:cpio modprobe:kmod xz:xz-utils; do
    command -v "${need%%:*}" >/dev/null || packages+=("${need#*:}")
done
# An ordinary busybox needs libraries that the initramfs does not have.
if command -v busybox >/dev/null && ldd "$(command -v busybox)" >/dev/null 2>&1; then packages+=(busybox-static); fi
if [ "${#packages[@]}" != 0 ]; then
    [ -n "$root" ] || skip "no ${packages[*]}, and only root can install packages"
    lists "${packages[*]}"
    apt install -y --no-install-recommends "${packages[@]}" || skip "could not install ${packages[*]}: $(why)"
fi

# A kernel unpacks itself when it starts, which takes 7 s in the machine; QEMU can start it as ELF, too. Debian's is packed
# with xz; where it is (payload_offset, payload_length) stands in its header. One that is packed otherwise is left as it is.
unpack_kernel() { # VMLINUZ VMLINUX
    number() { od -An -t "u$2" -j "$1" -N "$2" "$vmlinuz" | tr -d ' '; }
    local vmlinuz=$1 offset
    offset=$((($(number 497 1) + 1) * 512 + $(number 584 4)))
    tail -c "+$((offset + 1))" "$vmlinuz" | head -c "$(number 588 4)" | xz -dc --single-stream >"$2" 2>/dev/null || true
    [ "$(head -c 4 "$2" | tail -c 3)" = ELF ]
}

# The parts that the guest needs. Not every kernel has every folder, so what matched nothing is no error.
unpack_package() { # PACKAGE, in a folder of its own, where its file is
    dpkg-deb --fsys-tarfile ./"$1"_*.deb | tar -x --wildcards "./boot/vmlinuz-*" "./lib/modules/*/modules.*" \
        "./lib/modules/*/kernel/drivers/"{hid,input,usb,virtio}"/*" \
        "./lib/modules/*/kernel/"{fs/9p,fs/netfs,fs/fscache,fs/overlayfs,net/9p,lib,crypto}"*" 2>/dev/null || true
    rm -f ./"$1"_*.deb
    version=$(ls lib/modules) && [ -e "boot/vmlinuz-$version" ] || return 1
    depmod -b . "$version"
    unpack_kernel "boot/vmlinuz-$version" boot/vmlinux || rm -f boot/vmlinux
    echo "$version" >ready
}

mkdir -p "$lab/kernels" 2>/dev/null && [ -w "$lab/kernels" ] || skip "no folder $lab to keep kernels in: name one with HAPTICD_VM"
unpacking=()
for flavour in amd64 rt-amd64; do
    folder=$lab/kernels/$flavour
    [ ! -e "$folder/ready" ] || continue
    lists "kernel $flavour"
    package=$(apt-cache depends "linux-image-$flavour" 2>/dev/null | awk '/Depends: linux-image/ {print $2; exit}') || true
    [ -n "$package" ] || skip "no kernel $flavour, and no linux-image-$flavour among apt's packages (Debian has it)"
    rm -rf "$folder"
    mkdir -p "$folder"
    cd "$folder"
    as_root='' apt download "$package" || skip "no kernel $flavour, and $package cannot be fetched: $(why)"
    unpack_package "$package" &
    unpacking+=("$!:$package")
done
if [ ! -e "$lab/udev/lib/udev" ]; then
    lists udevadm
    rm -rf "$lab/udev"
    mkdir -p "$lab/udev"
    cd "$lab/udev"
    as_root='' apt download udev || skip "no udevadm, and udev cannot be fetched: $(why)"
    dpkg-deb --fsys-tarfile ./udev_*.deb | tar -x ./bin/udevadm ./lib/udev ./lib/systemd
    rm -f ./udev_*.deb
fi
for entry in "${unpacking[@]}"; do
    wait "${entry%%:*}" || skip "${entry#*:} does not hold the kernel as expected"
done
