"""HID devices: found, evaluated, set up, driven, lost and found again.

From a plugged-in device to a force, in this order:

    discovery           which HID devices there are, by sysfs, and the one that the configuration means
    descriptor/         what a report descriptor says: items, fields, reports and axes
    verdict             decides whether a device can be driven, and why not; everything that says so asks here
    drivers/            a class of devices each: its set-up and its plan
        pid             set-up of the PID class: reset, effects made, started with a force of zero
        pid_plan        two effects, one with a direction, or one axis; what is sent afterwards; effects that play
        pid_reports     directions, and each report encoded: Set Effect, Set Constant Force, Effect Operation, ...
        vendor          devices with reports of their own, as device.hid.report describes them
    plan                what a connection does, as data, handed to C as struct hd_hid_plan
    sources             a configuration's device: a hidraw node or a recording
    device              what set-up does with a device: sends reports, reads features
    replay              a recording that stands in for a device
    connection          a thread: sets up, hands over, waits, sets up again after a reset, and looks for what is gone
    link                how fast forces go out, and how often effects are restored at that speed

Beside that way:

    signs               the check, before the first force, of which way a device pushes
    sign_calibration    `hapticd devices calibrate`: finds out which way it pushes
    nearest_effect      the effect of a device that is nearest to a mode
    offload             which mode has which effect
    stopper             a file and a process that stop a device whose daemon was killed
    claim               keeps other programs off a device
    device_texts        sentences about devices that clients print, too; cheap to load

What happens every few milliseconds is in C: csrc/device/hd_hid_reader.c and hd_hid_writer.c, behind hd_hid_mailboxes.c.

Questions, and where to begin:

    Can this device be driven?
        verdict (verdict_of); what a descriptor must have: descriptor/layout (_REPORTS).
    How is an effect uploaded?
        drivers/pid (_create, _constant), encoded by drivers/pid_reports.
    What happens to an effect when the cable is pulled?
        It is gone with the device's memory. C ends reader and writer, and the servo reports the fault `device`.
        connection lets go (_lose, _let_go; offload no longer offers effects), and has the effects made again when the
        device is back (_connect). A device that still has power lets its effects end by their finite duration.
    What if another program resets the device, or changes an effect?
        connection (_recover); where the device does not report it, link (paced).
    What if the daemon is killed?
        stopper; in a fault of the process csrc/device/hd_last_report.c.
"""
