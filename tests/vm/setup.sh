#!/bin/bash
# setup.sh: QEMU and Debian's kernels, ordinary and PREEMPT_RT, into $HAPTICD_VM (default ~/.cache/hapticd-vm).
# Run again it does nothing. Where it cannot be done it prints why and ends with 77; the host keeps its own kernel.
set -euo pipefail
lab=${HAPTICD_VM:-$HOME/.cache/hapticd-vm}
skip() { echo "$*"; exit 77; }

[ "$(uname -m)" = x86_64 ] || skip "the virtual machine is an x86_64, this is $(uname -m)"
as_root=
[ "$(id -u)" = 0 ] || { sudo -n true 2>/dev/null && as_root="sudo -n"; } || as_root=none

# The updating of apt's lists is put off until something is missing.
listed=
lists() {
    [ -z "$listed" ] || return 0
    [ "$as_root" != none ] || skip "$1 is missing, and only root can install it"
    $as_root apt-get -o DPkg::Lock::Timeout=120 -o Acquire::Retries=2 update -qq >/dev/null 2>&1 ||
        skip "apt-get update failed (no network?), and $1 is missing"
    listed=1
}

packages=()
for need in qemu-system-x86_64:qemu-system-x86 busybox:busybox-static cpio:cpio modprobe:kmod; do
    PATH=$PATH:/usr/sbin:/sbin command -v "${need%%:*}" >/dev/null || packages+=("${need#*:}")
done
# An ordinary busybox needs libraries that the initramfs does not have.
[ "${#packages[@]}" = 0 ] && ldd "$(command -v busybox)" >/dev/null 2>&1 && packages+=(busybox-static)
if [ "${#packages[@]}" != 0 ]; then
    command -v apt-get >/dev/null || skip "no ${packages[0]}, and no apt-get to install it"
    lists "${packages[0]}"
    DEBIAN_FRONTEND=noninteractive $as_root apt-get -o DPkg::Lock::Timeout=120 -o Acquire::Retries=2 install -y -qq \
        --no-install-recommends "${packages[@]}" >/dev/null 2>&1 || skip "could not install ${packages[*]}"
fi

mkdir -p "$lab/kernels"
for flavour in amd64 rt-amd64; do
    [ ! -e "$lab/kernels/$flavour/ready" ] || continue
    command -v apt-get >/dev/null || skip "no kernel $flavour, and no apt-get to fetch it"
    lists "a kernel"
    package=$(apt-cache depends "linux-image-$flavour" 2>/dev/null | awk '/Depends: linux-image/ {print $2; exit}')
    [ -n "$package" ] || skip "no linux-image-$flavour among apt's packages (Debian has it)"
    rm -rf "$lab/kernels/$flavour"
    mkdir -p "$lab/kernels/$flavour"
    (
        cd "$lab/kernels/$flavour"
        apt-get -o Acquire::Retries=2 download -qq "$package" >/dev/null 2>&1 || exit 1
        # The parts that the guest needs. Not every kernel has every folder, so what matched nothing is no error.
        dpkg-deb --fsys-tarfile ./"$package"_*.deb | tar -x --wildcards "./boot/vmlinuz-*" "./lib/modules/*/modules.*" \
            "./lib/modules/*/kernel/drivers/"{hid,input,usb,virtio}"/*" \
            "./lib/modules/*/kernel/"{fs/9p,fs/netfs,fs/fscache,fs/overlayfs,net/9p,lib,crypto}"*" 2>/dev/null || true
        rm -f ./"$package"_*.deb
        version=$(ls lib/modules)
        [ -e "boot/vmlinuz-$version" ] || exit 1
        PATH=$PATH:/usr/sbin:/sbin depmod -b . "$version"
        echo "$version" >ready
    ) || { rm -rf "$lab/kernels/$flavour"; skip "could not fetch $package"; }
done
