"""Drives HID joysticks with force feedback: discovery, set-up, connection, recovery after a loss or a reset.

From a plugged-in device to a force, in this order:

    discovery           lists the HID devices of sysfs, and chooses the one that the configuration selects
    descriptor/         parses report descriptors: items, fields, reports and axes
    verdict             decides whether a device can be driven, and why not; every command uses this decision
    drivers/            for each class of devices, the set-up and the plan (see `plan` below)
        pid             set-up of the PID class: reset, creation of effects, start with a force of zero
        pid_plan        the plan of the PID class: two effects, one effect with a direction, or one axis
        pid_reports     encodes directions and reports: Set Effect, Set Constant Force, Effect Operation, ...
        vendor          devices with vendor reports, as device.hid.report describes them
    plan                where positions are in reports, and which reports carry forces, as struct hd_hid_plan for C
    sources             opens the device of a configuration: a hidraw node or a recording
    device              access to an open device: output reports, feature reports, input reports
    replay              a recording that is played as a device
    connection          the thread that sets up a device, recovers it after a reset, and reconnects it after a loss
    link                the rate at which the device accepts forces, and the interval at which effects are restored

Besides that:

    signs               the check, before the first force, of the direction in which a device pushes
    sign_calibration    `hapticd devices calibrate`: finds the direction in which a device pushes
    range_calibration   `hapticd devices calibrate`: measures the range of the handle
    handle_use          warnings about a handle that rests inside an object, or does not reach the ends of its range
    nearest_effect      the device effect that is nearest to a mode
    offload             assigns device effects to modes
    stopper             a record and a command that stop a device whose daemon was killed
    claim               keeps other programs off a device
    device_texts        texts about devices, which clients print, too

C reads positions and writes forces: csrc/device/hd_hid_reader.c and hd_hid_writer.c.

Questions, and where to begin:

    Can this device be driven?
        verdict (verdict_of); the reports that a descriptor must have: descriptor/layout (_PID_REPORTS).
    How is an effect uploaded?
        drivers/pid (_create, _create_constant_forces), encoded by drivers/pid_reports.
    What happens to an effect when the cable is pulled?
        The device loses it with its power. C ends the reader and writer threads; the servo reports the fault `device`.
        connection disconnects (_lose, _disconnect; offload offers no effects then), and creates the effects again when
        the device is back (_connect). On a device that still has power, effects end after their finite duration.
    What if another program resets the device, or changes an effect?
        connection (_recover); if the device does not report it, link (plan_paced_for_link).
    What if the daemon is killed?
        stopper; after a crash of the process, such as SIGSEGV, csrc/device/hd_last_report.c.
"""
