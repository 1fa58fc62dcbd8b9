/* The servo's device: the simulated joystick or a HID device. Only the servo thread uses it.
 *
 * The files of this room:
 *
 *   hd_device          one of the two, behind the same functions
 *   hd_sim             the simulated joystick: what the servo calls
 *   hd_sim_setup       makes and frees a simulation, sets its period and position
 *   hd_sim_state       what the files of the simulation share
 *   hd_sim_time        advances time from event to event
 *   hd_sim_solver      the motion of the handle between two events
 *   hd_actuator        a lagging actuator
 *   hd_operator        the path of the hand: waypoints, split into segments
 *   hd_gesture_end     the event at the end of such a path
 *   hd_hid             a HID device: what the servo calls
 *   hd_hid_connection  what the files of a HID device share: mailboxes, threads, the end of a connection
 *   hd_hid_control     connects and disconnects a HID device; its counters
 *   hd_hid_mailboxes   the servo's side: newest position, newest force
 *   hd_hid_interval    the time between two positions
 *   hd_hid_reader      the thread that reads reports
 *   hd_hid_writer      the thread that writes reports
 *   hd_report          reports: reads positions from them, writes forces into them
 *   hd_effects         turns strikes that the device plays into reports
 *   hd_signs           the check of the direction in which a device pushes
 *   hd_last_report     zero force when the process crashes */
#ifndef HD_DEVICE_H
#define HD_DEVICE_H

#include "base/hd_memory.h"
#include "device/hd_gesture_end.h"
#include "device/hd_hid.h"
#include "device/hd_signs.h"
#include "device/hd_sim.h"

/* One of the two is NULL. */
struct hd_device {
    struct hd_sim *sim;
    struct hd_hid *hid;
};

/* Control: takes a reference for the servo, which hd_device_free drops. */
static inline void hd_device_hold(const struct hd_device *device) {
    if (device->sim != NULL) {
        hd_sim_hold(device->sim);
    } else {
        hd_hid_hold(device->hid);
    }
}

static inline void hd_device_free(const struct hd_device *device) {
    hd_sim_free(device->sim);
    hd_hid_free(device->hid);
}

/* Advances a simulated device by `periods` servo periods. */
HD_RT static inline void hd_device_advance(const struct hd_device *device, uint32_t periods) {
    if (device->sim != NULL) {
        hd_sim_step_advance(device->sim, periods);
    }
}

HD_RT static inline void hd_device_look(const struct hd_device *device, int64_t now_ns, struct hd_look *look) {
    if (device->sim != NULL) {
        hd_sim_step_read(device->sim, &look->reading);
        look->connection = 1;
        look->fresh = look->reading.interval_s > 0.0;
        look->gone = 0;
        look->idle = 0;
        look->signs = NULL;
    } else {
        hd_hid_step_look(device->hid, now_ns, look);
    }
}

HD_RT static inline void hd_device_put(const struct hd_device *device, int64_t now_ns, const double force_n[2]) {
    if (device->sim != NULL) {
        hd_sim_step_put(device->sim, force_n);
    } else {
        hd_hid_step_put(device->hid, now_ns, force_n);
    }
}

/* Prefetches the memory of the device that the next tick uses. */
HD_RT static inline void hd_device_fetch(const struct hd_device *device) {
    if (device->sim != NULL) {
        hd_sim_step_fetch(device->sim);
    } else {
        hd_hid_step_fetch(device->hid);
    }
}

/* Returns whether the device plays effects, so that strikes can be sent to it. */
HD_RT static inline int hd_device_has_effects(const struct hd_device *device) {
    return device->hid != NULL && hd_hid_step_has_effects(device->hid);
}

/* Returns the memory of the device that the servo uses. */
static inline struct hd_region hd_device_region(const struct hd_device *device) {
    return device->sim != NULL ? (struct hd_region){device->sim, hd_sim_size()}
                               : (struct hd_region){device->hid, hd_hid_size()};
}

#endif
