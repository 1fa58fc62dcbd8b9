#!/bin/bash
# lint.sh: lintian on the package in build/deb (make test-deb); an error is a failure, and so is an override that nothing
# needs. Root's call installs lintian.
set -euo pipefail
cd "$(dirname "$0")/.."
if ! command -v lintian >/dev/null; then
    if [ "$(id -u)" != 0 ] || ! command -v apt-get >/dev/null; then
        echo "the package is checked with lintian: install it (apt install lintian)" >&2
        exit 1
    fi
    echo "installing lintian"
    export DEBIAN_FRONTEND=noninteractive
    apt-get update -qq
    apt-get install -y -qq --no-install-recommends lintian >/dev/null
fi
as_root=()
[ "$(id -u)" != 0 ] || as_root=(--allow-root)
said=$(lintian "${as_root[@]}" --fail-on error --tag-display-limit 0 build/deb/hapticd_*.deb 2>&1) || {
    echo "$said" >&2
    exit 1
}
if grep -E '(unused|mismatched)-override' <<<"$said" >&2; then exit 1; fi
echo "lintian: no error, $(grep -c '^W: ' <<<"$said" || true) warnings"
