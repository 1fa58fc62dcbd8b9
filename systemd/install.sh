#!/bin/sh
# Installs or removes the files of the service, and prints each command. `hapticd install-service` and the build of the
# Debian package run it.
#
#   CONFIG=FILE [VARIABLE=...] sh install.sh system|user|remove-system|remove-user
#
# CONFIG        absolute path of the initial configuration; an existing one is kept
# ROOT          absolute path to prefix to all others, as a package's folder; the running system is then not changed
# LIB           folder of sysusers.d, tmpfiles.d and udev rules [/etc]
# UNITS, RULES  folders of the units and of the udev rules [$LIB/systemd/system, $LIB/udev/rules.d]
# DRY           if set, commands are printed and not run
set -eu
cd "$(dirname "$0")"
root=${ROOT-} lib=${LIB-/etc}
units=$root${UNITS-$lib/systemd/system} rules=$root${RULES-$lib/udev/rules.d}
home=${XDG_CONFIG_HOME-${HOME-}/.config}

run() {
    echo "$*"
    [ -n "${DRY-}" ] || "$@"
}
put() { run install -D -m 644 "$1" "$2"; }
begin() { [ -e "$1" ] || put "$CONFIG" "$1"; }
has() { command -v "$1" >/dev/null || { echo "$1: not found; run it later"; false; }; }
systemd_runs() { [ -z "$root" ] && [ -d /run/systemd/system ]; }
udev_runs() { [ -z "$root" ] && [ -e /run/udev/control ]; }
user_systemd_runs() { [ -e "${XDG_RUNTIME_DIR-/run/user/$(id -u)}/systemd/private" ]; }

case $1 in
system)
    put hapticd.service "$units/hapticd.service"
    put hapticd-web.service "$units/hapticd-web.service"
    put sysusers.conf "$root$lib/sysusers.d/hapticd.conf"
    put tmpfiles.conf "$root$lib/tmpfiles.d/hapticd.conf"
    put 70-hapticd.rules "$rules/70-hapticd.rules"
    put 70-hapticd-idle.rules "$rules/70-hapticd-idle.rules"
    begin "$root/etc/hapticd/config.yaml"
    if [ -z "$root" ]; then
        ! has systemd-sysusers || run systemd-sysusers hapticd.conf
        ! has systemd-tmpfiles || run systemd-tmpfiles --create hapticd.conf
    fi
    if udev_runs; then
        run udevadm control --reload
        run udevadm trigger --subsystem-match=hidraw
        run udevadm trigger --name-match=/dev/cpu_dma_latency
    fi
    ! systemd_runs || run systemctl daemon-reload
    ;;
user)
    put hapticd.user.service "$home/systemd/user/hapticd.service"
    begin "$home/hapticd/config.yaml"
    ! user_systemd_runs || run systemctl --user daemon-reload
    ;;
remove-system)
    ! systemd_runs || run systemctl disable --now hapticd.service hapticd-web.service
    run rm -f "$units/hapticd.service" "$units/hapticd-web.service" "$root$lib/sysusers.d/hapticd.conf" \
        "$root$lib/tmpfiles.d/hapticd.conf" "$rules/70-hapticd.rules" "$rules/70-hapticd-idle.rules"
    ! udev_runs || run udevadm control --reload
    ! systemd_runs || run systemctl daemon-reload
    ;;
remove-user)
    ! user_systemd_runs || run systemctl --user disable --now hapticd.service
    run rm -f "$home/systemd/user/hapticd.service"
    ! user_systemd_runs || run systemctl --user daemon-reload
    ;;
*)
    echo "install.sh: system, user, remove-system or remove-user" >&2
    exit 2
    ;;
esac
