#!/bin/bash
# test.sh: everything that needs a kernel of its own (make test-vm). One machine for what happens, one with the
# PREEMPT_RT kernel for how long it takes, at the same time. Where QEMU or the kernels cannot be had it says why, and that
# is no failure. With -s: the installed service under systemd instead, and beside it the same under attack (make
# test-systemd). With -d: the Debian package of build/deb under systemd (make test-deb).
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd) tree=$(cd "$(dirname "$0")/../.." && pwd)
out=$tree/build/vm
mkdir -p "$out"

begin=$SECONDS code=0
said=$(bash "$here/setup.sh") || code=$?
if [ "$code" = 77 ]; then
    echo "skipped: $said"
    exit 0
elif [ "$code" != 0 ]; then
    echo "tests/vm/setup.sh failed with exit code $code${said:+: $said}" >&2
    exit "$code"
fi
echo "the machines are ready after $((SECONDS - begin)) s"

if [ -n "${1:-}" ]; then
    [ -x /lib/systemd/systemd ] || { echo "skipped: no /lib/systemd/systemd here, which the machine would start"; exit 0; }
fi
if [ "${1:-}" = -d ]; then
    # The version before it: the same with a lower number, and with another configuration, so that dpkg has to decide.
    before=$tree/build/deb/before
    rm -rf "$before"
    mkdir -p "$before"
    dpkg-deb -R "$tree"/build/deb/hapticd_*.deb "$before/tree"
    sed -i 's/^Version: .*/Version: 0.0.1-1/' "$before/tree/DEBIAN/control"
    echo "# The version before." >>"$before/tree/etc/hapticd/config.yaml"
    dpkg-deb --root-owner-group -Zgzip -z1 -b "$before/tree" "$before" >/dev/null
    rm -rf "$before/tree"
    failed=0
    bash "$here/run.sh" -s -t "${VM_SECONDS:-3600}" job_package.py || failed=1
    echo "all jobs after $((SECONDS - begin)) s"
    exit "$failed"
fi
if [ "${1:-}" = -s ]; then
    limit=${VM_SECONDS:-1800} failed=0
    bash "$here/run.sh" -s -k rt-amd64 -t "$limit" job_attack.py >"$out/attack.log" 2>&1 &
    beside=$!
    bash "$here/run.sh" -s -t "$limit" job_system.py || failed=1
    wait "$beside" || failed=1
    cat "$out/attack.log"
    echo "all jobs after $((SECONDS - begin)) s"
    exit "$failed"
fi
limit=${VM_SECONDS:-600}
bash "$here/run.sh" -k rt-amd64 -t "$limit" job_latency.py job_vendor.py >"$out/rt.log" 2>&1 &
beside=$!
failed=0
bash "$here/run.sh" -t "$limit" job_device.py job_pid.py job_firmware.py || failed=1
wait "$beside" || failed=1
cat "$out/rt.log"
echo "all jobs after $((SECONDS - begin)) s"
exit "$failed"
