#!/bin/bash
# run.sh [-k amd64|rt-amd64] [-t SECONDS] JOB.py...: jobs in a virtual machine, one after the other, as root, under Debian's
# kernel. run.sh -s [-t SECONDS] JOB.py: one job, under systemd and udev (systemd.sh).
#
# The machine's root is the host's, read only, with a layer in memory over it; what a job writes to $VM_OUT arrives in
# build/vm/KERNEL. Time is virtual: an instruction takes 1 ns, and where nothing is to be done time jumps. So a busy host makes
# a job longer, never late, and times within the machine may be asserted. The exit code is that of the first job that
# failed, else 0; 124: it took too long, SECONDS of the host's time for all jobs (default 240).
#
# What the host has to translate is what takes time, so: no random addresses, which would have every process translated
# anew; no instructions that QEMU carries out byte by byte (rep movs, rep stos) or that end a translated block (stac).
# And no AVX2: with that of QEMU 7.2, numpy's argsort returns wrong places, or crashes.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd) tree=$(cd "$(dirname "$0")/../.." && pwd)
lab=${HAPTICD_VM:-$HOME/.cache/hapticd-vm}
python=${PYTHON:-$tree/.venv/bin/python}
flavour=amd64 limit=240 within=60 systemd=
while getopts k:t:s option; do
    case $option in k) flavour=$OPTARG ;; t) limit=$OPTARG ;; s) systemd=$lab/udev ;; *) exit 2 ;; esac
done
shift $((OPTIND - 1))
jobs=$(IFS=,; echo "$*")

kernel=$lab/kernels/$flavour initramfs=$lab/initramfs-$flavour
[ -e "$kernel/ready" ] || { echo "no kernel $flavour: run tests/vm/setup.sh first" >&2; exit 2; }
for source in "$here"/{init,spin.c,mkinitramfs.sh} "$kernel/ready"; do
    [ "$initramfs" -nt "$source" ] || { bash "$here/mkinitramfs.sh" "$kernel" "$initramfs" && break; }
done
out=$tree/build/vm/${systemd:+systemd-}$flavour
rm -rf "$out"
mkdir -p "$out"
"$python" -m compileall -q "$tree/hapticd" "$here"
"${CC:-cc}" -std=c11 -O2 -Wall -Wextra -D_GNU_SOURCE "$here/floor.c" -o "$out/floor"

share() { # ID PATH OPTIONS
    echo "-fsdev local,id=$1,path=$2,security_model=none,multidevs=remap$3 -device virtio-9p-pci,fsdev=$1,mount_tag=$1"
}
image=$kernel/boot/vmlinux
[ -e "$image" ] || image=$kernel/boot/vmlinuz-$(cat "$kernel/ready")
code=0
# shellcheck disable=SC2046
timeout -k 5 "$limit" qemu-system-x86_64 -M q35 -smp 1 -m 1024 -cpu max,erms=off,fsrm=off,smap=off,smep=off,la57=off,avx2=off \
    -accel tcg,thread=single,tb-size=512 -icount shift=0,sleep=off \
    -nodefaults -no-user-config -display none -no-reboot -serial stdio \
    -kernel "$image" -initrd "$initramfs" \
    -append "console=ttyS0 quiet loglevel=3 panic=-1 mitigations=off tsc=reliable no_timer_check norandmaps nokaslr \
noreplace-smp clearcpuid=rep_good,erms,fsrm vm_tree=$tree vm_out=$out vm_python=$python vm_udevadm=$lab/udev/bin/udevadm \
vm_limit=$within vm_systemd=$systemd ${systemd:+systemd.unit=job.service systemd.show_status=0} vm_job=$jobs" \
    $(share host / ,readonly=on) $(share out "$out" "") </dev/null || code=$?
if [ -e "$out/code" ]; then exit "$(cat "$out/code")"; fi
if [ "$code" = 124 ]; then
    echo "  FAILED $(cat "$out/job" 2>/dev/null || echo "the machine's start") was not done after $limit s" >&2
else
    echo "  FAILED ${jobs//,/, }: no result, QEMU ended with $code" >&2
fi
[ "$code" != 0 ] || code=99
exit "$code"
