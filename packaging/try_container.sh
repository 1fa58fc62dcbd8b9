#!/usr/bin/env bash
# Builds packaging/Containerfile and runs the image to a first tap, with a client on the host: `make container-test`, as root.
#
# It needs buildah. BASE is the image below it; without one, debootstrap (Debian) makes the base, so that no registry is needed.
# HAPTICD_BUILD_VOLUME=/from:/to:ro is mounted while it is built. Behind a proxy with its own certificate, which pip in the
# image rejects otherwise: HAPTICD_BUILD_VOLUME=/etc/ssl/certs:/etc/ssl/certs:ro.
set -euo pipefail
cd "$(dirname "$0")/.."

for program in buildah $([ -n "${BASE:-}" ] || echo debootstrap); do
    command -v "$program" >/dev/null || { echo "make container-test needs $program: apt install buildah debootstrap" >&2; exit 1; }
done
[ "$(id -u)" = 0 ] || { echo "make container-test needs root: sudo make container-test" >&2; exit 1; }

python=${PYTHON:-.venv/bin/python}
# Everything in a folder of its own: no image of this machine is seen, none is left.
work=$(mktemp -d /tmp/hapticd-container-XXXXXX)
container=
finish() {
    if [ -n "$container" ]; then
        # The daemon's own number: isolated by chroot alone, it is one of the host's.
        kill "$(cat "$work/runtime/hapticd.lock" 2>/dev/null || echo "$container")" 2>/dev/null || true
        wait "$container" || true
    fi
    buildah rm --all >/dev/null 2>&1 || true
    # debootstrap mounts below it, and may have been ended before it took that away.
    umount "$work/root/proc" "$work/root/sys" 2>/dev/null || true
    rm -rf --one-file-system "$work"
}
trap finish EXIT
export CONTAINERS_STORAGE_CONF="$work/storage.conf" BUILDAH_ISOLATION=chroot
printf '[storage]\ndriver = "vfs"\nrunroot = "%s/run"\ngraphroot = "%s/graph"\n' "$work" "$work" >"$CONTAINERS_STORAGE_CONF"

options=()
if [ -z "${BASE:-}" ]; then
    echo "a base of Debian, made by debootstrap"
    debootstrap --variant=minbase --include=ca-certificates,python3,python3-venv stable "$work/root" \
        "${MIRROR:-http://deb.debian.org/debian}" >"$work/debootstrap.log" || { tail "$work/debootstrap.log" >&2; exit 1; }
    tar -C "$work/root" --one-file-system -cf "$work/base.tar" . && rm -rf --one-file-system "$work/root"
    BASE=localhost/hapticd-base
    printf 'FROM scratch\nADD base.tar /\n' | buildah build -q -f - -t "$BASE" "$work" >/dev/null
    rm "$work/base.tar"
    # Its headers of Python are a package.
    options+=(--build-arg "PACKAGES=gcc libc6-dev python3-dev")
fi
[ -z "${HAPTICD_BUILD_VOLUME:-}" ] || options+=(--volume "$HAPTICD_BUILD_VOLUME")

echo "the image, on $BASE"
buildah build --build-arg "BASE=$BASE" "${options[@]}" -f packaging/Containerfile -t localhost/hapticd . >"$work/build.log" 2>&1 ||
    { tail -n 40 "$work/build.log" >&2; exit 1; }
buildah images --format '{{.Name}}: {{.Size}}' localhost/hapticd

# As the image says: its user. The runtime directory is the host's. The limits are those that docs/install.md names, where this
# machine lets root give them.
limits=()
wanted=other
if prlimit --rtprio=99:99 --memlock=unlimited:unlimited true 2>/dev/null; then
    limits=(--ulimit rtprio=99:99 --ulimit memlock=-1:-1)
    wanted=fifo
else
    echo "without real-time rights, which this machine does not let root give"
fi
built=$(buildah from "${limits[@]}" localhost/hapticd)
uid=$(buildah run "$built" -- id -u)
[ "$uid" != 0 ] || { echo "the image runs as root; it would be hapticd" >&2; exit 1; }
install --directory --owner="$uid" --mode=0700 "$work/runtime"
buildah run --volume "$work/runtime:/run/hapticd" "$built" -- hapticd run --quiet --config materials &
container=$!
"$python" - "$work/runtime" "$wanted" <<'PYTHON'
import sys

import hapticd

with hapticd.connect(sys.argv[1], wait_s=60) as daemon, daemon.events() as events:
    daemon.set_operator(gesture={"kind": "tap", "object": "wood", "speed_m_per_s": 0.1})
    contact = next(event for event in events if event["event"] == "contact")
    assert contact["object"] == "wood", contact
    scheduler = daemon.get_status()["realtime"]["scheduler"]
    assert scheduler == sys.argv[2], scheduler
    print(f"a tap on {contact['object']} in the container, asked for and seen on the host; scheduler {scheduler}")
PYTHON
kill -TERM "$(cat "$work/runtime/hapticd.lock")"
wait "$container" || { echo "the daemon in the container: exit code $? after SIGTERM; it would be 0" >&2; exit 1; }
container=
buildah run "$built" -- hapticd simulate materials
