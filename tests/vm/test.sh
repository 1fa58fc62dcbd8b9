#!/bin/bash
# test.sh: everything that needs a kernel of its own (make test-vm). One machine for what happens, one with the
# PREEMPT_RT kernel for how long it takes, at the same time. Where QEMU or the kernels cannot be had it says why, and that
# is no failure.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd) tree=$(cd "$(dirname "$0")/../.." && pwd)
out=$tree/build/vm
mkdir -p "$out"

begin=$SECONDS
if ! said=$(bash "$here/setup.sh"); then
    echo "skipped: ${said:-set-up failed}"
    exit 0
fi
echo "the machines are ready after $((SECONDS - begin)) s"

bash "$here/run.sh" -k rt-amd64 -t "${VM_SECONDS:-600}" job_latency.py >"$out/latency.log" 2>&1 &
latency=$!
failed=0
bash "$here/run.sh" -t "${VM_SECONDS:-600}" job_device.py job_pid.py job_vendor.py || failed=1
wait "$latency" || failed=1
cat "$out/latency.log"
echo "all jobs after $((SECONDS - begin)) s"
exit "$failed"
