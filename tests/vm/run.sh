#!/bin/bash
# run.sh [-k amd64|rt-amd64] [-t SECONDS] JOB.py...: jobs in a virtual machine, one after the other, as root, under Debian's
# kernel.
#
# The machine's root is the host's, read only, with a layer in memory over it; what a job writes to $VM_OUT arrives in
# build/vm/KERNEL. Time is virtual: an instruction takes 1 ns, and where nothing is to be done time jumps. So a busy host makes
# a job longer, never late, and times within the machine may be asserted. The exit code is that of the job that
# failed, else 0; 124: it took too long.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd) tree=$(cd "$(dirname "$0")/../.." && pwd)
lab=${HAPTICD_VM:-$HOME/.cache/hapticd-vm}
python=${PYTHON:-$tree/.venv/bin/python}
flavour=amd64 limit=240
while getopts k:t: option; do
    case $option in k) flavour=$OPTARG ;; t) limit=$OPTARG ;; *) exit 2 ;; esac
done
shift $((OPTIND - 1))
job=$(IFS=,; echo "$*")

kernel=$lab/kernels/$flavour initramfs=$lab/initramfs-$flavour
[ -e "$kernel/ready" ] || { echo "no kernel $flavour: run tests/vm/setup.sh first" >&2; exit 2; }
for source in init spin.c mkinitramfs.sh; do
    [ "$initramfs" -nt "$here/$source" ] || { bash "$here/mkinitramfs.sh" "$kernel" "$initramfs" && break; }
done
out=$tree/build/vm/$flavour
rm -rf "$out"
mkdir -p "$out"
"${CC:-cc}" -std=c11 -O2 -Wall -Wextra -D_GNU_SOURCE "$here/floor.c" -o "$out/floor"

share() { # ID PATH OPTIONS
    echo "-fsdev local,id=$1,path=$2,security_model=none,multidevs=remap$3 -device virtio-9p-pci,fsdev=$1,mount_tag=$1"
}
code=0
# shellcheck disable=SC2046
timeout -k 5 "$limit" qemu-system-x86_64 -M q35 -smp 1 -m 1024 -cpu max -accel tcg,thread=single,tb-size=512 \
    -icount shift=0,sleep=off -nodefaults -no-user-config -display none -no-reboot -serial stdio \
    -kernel "$kernel/boot/vmlinuz-$(cat "$kernel/ready")" -initrd "$initramfs" \
    -append "console=ttyS0 quiet loglevel=3 panic=-1 mitigations=off tsc=reliable no_timer_check \
vm_tree=$tree vm_out=$out vm_python=$python vm_job=$job" \
    $(share host / ,readonly=on) $(share out "$out" "") </dev/null || code=$?
if [ -e "$out/code" ]; then exit "$(cat "$out/code")"; fi
echo "$job: no result, QEMU ended with $code" >&2
[ "$code" != 0 ] || code=99
exit "$code"
