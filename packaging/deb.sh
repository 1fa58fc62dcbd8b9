#!/bin/bash
# deb.sh PYTHON [VERSION]: dist/hapticd_VERSION_ARCH.deb (make deb), built in a copy of the tree below build/deb with the
# files of packaging/debian. PYTHON: that of .venv, which makes the copy. VERSION: that of the package, of itself
# hapticd's with -1 behind it. What the build needs root's call installs, and others are told.
set -euo pipefail
cd "$(dirname "$0")/.."
python=$1
upstream=$("$python" -c 'from hapticd import __version__; print(__version__)')
version=${2:-$upstream-1}

needs="build-essential debhelper dh-python python3-dev python3-venv"
missing=()
for package in $needs; do
    [ "$(dpkg-query -W -f '${db:Status-Status}' "$package" 2>/dev/null)" = installed ] || missing+=("$package")
done
if [ "${#missing[@]}" != 0 ]; then
    if [ "$(id -u)" != 0 ] || ! command -v apt-get >/dev/null; then
        echo "a Debian package needs ${missing[*]}: install them (apt install ${missing[*]})" >&2
        exit 1
    fi
    echo "installing ${missing[*]}"
    export DEBIAN_FRONTEND=noninteractive
    apt-get update -qq
    apt-get install -y -qq --no-install-recommends "${missing[@]}" >/dev/null
fi

folder=build/deb tree=build/deb/hapticd-$upstream
rm -rf "$folder"
mkdir -p "$folder" dist
"$python" -m build --no-isolation --sdist --outdir "$folder" . >"$folder/sdist.log" 2>&1 || { cat "$folder/sdist.log" >&2; exit 1; }
tar -xf "$tree.tar.gz" -C "$folder"
cp -R packaging/debian "$tree/debian"

# The day of the last change, so that the same tree gives the same package.
seconds=${SOURCE_DATE_EPOCH:-$(git log -1 --format=%ct 2>/dev/null || date +%s)}
cat >"$tree/debian/changelog" <<EOF
hapticd ($version) unstable; urgency=medium

  * hapticd $upstream; /usr/share/doc/hapticd/changelog.gz says what is new.

 -- $(sed -n 's/^Maintainer: //p' packaging/debian/control)  $(LC_ALL=C date -u -R -d "@$seconds")
EOF

# dh gives every command a home of its own, without what pip has fetched already.
cache=$("$python" -m pip cache dir 2>/dev/null || true)
(cd "$tree" && PIP_CACHE_DIR="$cache" dpkg-buildpackage -us -uc -b) >"$folder/build.log" 2>&1 || { cat "$folder/build.log" >&2; exit 1; }
file=hapticd_${version#*:}_$(dpkg --print-architecture).deb
cp "$folder/$file" dist/
echo "dist/$file: $(($(stat -c %s "dist/$file") / 1000000)) MB, $(dpkg-deb -f "dist/$file" Installed-Size) kB installed"
