# Read by `init`, in the guest: systemd as the first process, with journal and udev, and the job as a service. Nothing of
# the host's own services is started, no unit is made by a generator, and the journal stays in memory.
cp -a "/new$systemd/bin/udevadm" /new/usr/bin/
cp -a "/new$systemd/lib/udev" "/new$systemd/lib/systemd" /new/usr/lib/
echo 0123456789abcdef0123456789abcdef >/new/etc/machine-id
: >/new/etc/fstab
rm -f /new/.dockerenv
units=/new/etc/systemd/system
rm -rf "$units"/*.wants /new/usr/lib/systemd/system/*.wants /new/usr/lib/systemd/system-generators/*
mkdir -p "$units/sysinit.target.wants" "$units/sockets.target.wants" /new/etc/systemd/journald.conf.d
for unit in systemd-journald systemd-udevd; do
    ln -s "/lib/systemd/system/$unit.service" "$units/sysinit.target.wants/"
done
for unit in systemd-journald systemd-journald-dev-log systemd-udevd-control systemd-udevd-kernel; do
    ln -s "/lib/systemd/system/$unit.socket" "$units/sockets.target.wants/"
done
for unit in systemd-hwdb-update.service tmp.mount; do ln -sf /dev/null "$units/$unit"; done
printf '[Journal]\nStorage=volatile\n' >/new/etc/systemd/journald.conf.d/vm.conf
cat >"$units/job.service" <<EOF
[Unit]
Requires=basic.target
After=basic.target
[Service]
ExecStart=/bin/sh /run/job
ExecStopPost=/bin/sh -c 'echo \$EXIT_STATUS >$out/code; sync; echo b >/proc/sysrq-trigger'
StandardOutput=file:/dev/ttyS0
StandardError=inherit
EOF
exec switch_root /new /lib/systemd/systemd
