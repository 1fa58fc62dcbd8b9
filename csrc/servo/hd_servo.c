/* The life of a servo, on the control side: hd_servo_new allocates all memory that it ever uses; it is started,
 * stopped, and after an overload restarted at another rate. hd_servo.h lists its other files. */
#include "servo/hd_servo.h"

#include <errno.h>
#include <sched.h>
#include <stdlib.h>
#include <string.h>

#include "base/hd_clock.h"

static int config_check(const struct hd_servo_config *config) {
    if (!(config->rate_hz >= 1.0 && config->rate_hz <= 100000.0)) {
        return hd_invalid("servo: rate %g Hz is not between 1 and 100000", config->rate_hz);
    }
    if (config->spin_ns < 0 || (double)config->spin_ns > 1e9 / config->rate_hz) {
        return hd_invalid("servo: a busy-wait of %lld ns is longer than a period", (long long)config->spin_ns);
    }
    if (config->sample_capacity == 0 || (config->sample_capacity & (config->sample_capacity - 1)) != 0) {
        return hd_invalid("servo: %u samples are not a power of two", config->sample_capacity);
    }
    if (!(config->device_timeout_s > 0.0)) {
        return hd_invalid("servo: a device time-out of %g s is not above 0", config->device_timeout_s);
    }
    if (!(config->resolution_m >= 0.0 && config->resolution_m < 1.0)) {
        return hd_invalid("servo: an encoder step of %g m is not between 0 and 1", config->resolution_m);
    }
    if (!(config->overrun_threshold >= 0.0 && config->overrun_threshold <= 1.0) ||
        config->overrun_action > HD_OVERRUN_STEP_DOWN) {
        return hd_invalid("servo: an overrun threshold of %g is not between 0 and 1, or action %u is unknown",
                          config->overrun_threshold, config->overrun_action);
    }
    if (!(config->frozen_s >= 0.0 && config->frozen_force_n >= 0.0)) {
        return hd_invalid("servo: frozen after %g s under %g N: both must be at least 0", config->frozen_s,
                          config->frozen_force_n);
    }
    if (!(config->stream_timeout_s >= 0.002 && config->stream_timeout_s <= 1.0)) {
        return hd_invalid("servo: a time-out of streams of %g s is not between 0.002 and 1", config->stream_timeout_s);
    }
    if (config->clock != HD_CLOCK_TIMER && config->clock != HD_CLOCK_DEVICE) {
        return hd_invalid("servo: unknown clock %u", config->clock);
    }
    return HD_OK;
}

static void set_rate(struct hd_servo *servo, double rate_hz) {
    servo->config.rate_hz = rate_hz;
    servo->period_ns = 1e9 / rate_hz;
    servo->period_s = 1.0 / rate_hz;
    if (servo->device.hid != NULL) {
        /* A tick that a report triggers may be half a period early. */
        const double early = servo->config.clock == HD_CLOCK_DEVICE ? 0.5 : 1.0;
        hd_hid_expect_ticks(servo->device.hid, (int64_t)(early * servo->period_ns));
    }
}

struct hd_servo *hd_servo_new(const struct hd_servo_config *config, struct hd_sim *sim, struct hd_hid *hid) {
    if (config_check(config) != HD_OK) {
        return NULL;
    }
    if ((sim == NULL) == (hid == NULL)) {
        hd_invalid("servo: needs exactly one device, simulated or real");
        return NULL;
    }
    if (config->clock == HD_CLOCK_DEVICE && hid == NULL) {
        hd_invalid("servo: a simulated joystick cannot be the clock");
        return NULL;
    }
    struct hd_servo *servo = NULL;
    if (posix_memalign((void **)&servo, HD_CACHE_LINE, sizeof *servo) != 0) {
        hd_invalid("no memory for the servo");
        return NULL;
    }
    memset(servo, 0, sizeof *servo);
    servo->config = *config;
    servo->device = (struct hd_device){.sim = sim, .hid = hid};
    hd_device_hold(&servo->device);
    if (config->clock == HD_CLOCK_DEVICE) {
        hd_hid_await_enable(hid);
    }
    set_rate(servo, config->rate_hz);
    servo->suspended_ns = INT64_MAX - HD_SUSPEND_NS;
    hd_triple_init(&servo->table_triple);
    hd_triple_init(&servo->touching_triple);
    for (uint32_t kind = 0; kind < HD_STREAMS; kind++) {
        hd_triple_init(&servo->streams[kind].triple);
    }
    servo->state = hd_state_new(config->slot_capacity);
    if (servo->state == NULL ||
        hd_ring_init(&servo->commands, sizeof(struct hd_command), HD_COMMAND_CAPACITY) != HD_OK ||
        hd_ring_init(&servo->samples, sizeof(struct hd_sample), config->sample_capacity) != HD_OK ||
        hd_ring_init(&servo->events, sizeof(struct hd_event), HD_EVENT_RING_CAPACITY) != HD_OK) {
        hd_invalid("no memory for the servo");
        hd_servo_free(servo);
        return NULL;
    }
    hd_state_set_resolution(servo->state, config->resolution_m);
    servo->state->gain = 0.0;
    servo->state->enabled = config->forces_on != 0;
    return servo;
}

void hd_servo_free(struct hd_servo *servo) {
    if (servo == NULL) {
        return;
    }
    if (servo->started) {
        hd_servo_stop(servo);
    }
    hd_servo_free_paths(servo, servo->path_count);
    hd_device_free(&servo->device);
    for (int i = 0; i < 3; i++) {
        hd_world_release(&servo->worlds[i]);
    }
    hd_ring_destroy(&servo->commands);
    hd_ring_destroy(&servo->samples);
    hd_ring_destroy(&servo->events);
    hd_state_free(servo->state);
    free(servo);
}

/* Creates the thread with real-time priority or, if that is refused and not required, without. Returns 0 or an
 * errno. */
static int create_thread(struct hd_servo *servo, struct hd_grant *grant) {
    pthread_attr_t attributes;
    int error = pthread_attr_init(&attributes);
    if (error != 0) {
        return error;
    }
    if (servo->config.realtime != HD_REALTIME_OFF) {
        const struct sched_param parameter = {.sched_priority = servo->config.priority};
        pthread_attr_setinheritsched(&attributes, PTHREAD_EXPLICIT_SCHED);
        pthread_attr_setschedpolicy(&attributes, SCHED_FIFO);
        error = pthread_attr_setschedparam(&attributes, &parameter);
        if (error == 0) {
            error = pthread_create(&servo->thread, &attributes, hd_servo_main, servo);
        }
        if (error == 0) {
            grant->priority = servo->config.priority;
            pthread_attr_destroy(&attributes);
            return 0;
        }
        grant->scheduler = error;
        if (servo->config.realtime == HD_REALTIME_REQUIRED) {
            pthread_attr_destroy(&attributes);
            return error;
        }
    }
    pthread_attr_destroy(&attributes);
    return pthread_create(&servo->thread, NULL, hd_servo_main, servo);
}

static int launch(struct hd_servo *servo, struct hd_grant *grant) {
    hd_atomic_u32_store_relaxed(&servo->running, 1);
    const int error = create_thread(servo, grant);
    if (error != 0) {
        hd_atomic_u32_store_relaxed(&servo->running, 0);
        errno = error;
        return servo->config.realtime == HD_REALTIME_REQUIRED ? HD_ERR_DENIED : HD_ERR_SYSTEM;
    }
    servo->started = 1;
    if (servo->config.cpu >= 0) {
        cpu_set_t set;
        CPU_ZERO(&set);
        CPU_SET((size_t)servo->config.cpu, &set);
        grant->affinity = pthread_setaffinity_np(servo->thread, sizeof set, &set);
    }
    return HD_OK;
}

int hd_servo_start(struct hd_servo *servo, struct hd_grant *grant) {
    *grant = (struct hd_grant){.memory_kind = HD_MEMORY_NONE};
    if (servo->started || !hd_triple_acquire(&servo->table_triple)) {
        return hd_invalid("servo: already started, or no table was published");
    }
    servo->world = &servo->worlds[hd_triple_front(&servo->table_triple)];
    hd_atomic_u32_store_relaxed(&servo->adopted_revision[0], servo->world->table.revision);
    hd_atomic_u64_store_relaxed(&servo->adopted, 1);
    hd_atomic_u32_store_relaxed(&servo->revision, servo->world->table.revision);
    const int status = hd_servo_lock_memory(servo, grant);
    return status == HD_OK ? launch(servo, grant) : status;
}

int hd_servo_stop(struct hd_servo *servo) {
    if (!servo->started) {
        return HD_OK;
    }
    hd_atomic_u32_store_release(&servo->stopping, 1);
    const int error = pthread_join(servo->thread, NULL);
    if (error != 0) {
        errno = error;
        return HD_ERR_SYSTEM;
    }
    servo->started = 0;
    return HD_OK;
}

int hd_servo_set_rate(struct hd_servo *servo, double rate_hz, enum hd_overrun_action action) {
    if (!hd_atomic_u32_load_relaxed(&servo->overloaded)) {
        return hd_invalid("servo: the rate can change only after an overload");
    }
    struct hd_servo_config config = servo->config;
    config.rate_hz = rate_hz;
    config.overrun_action = action;
    config.spin_ns = (double)config.spin_ns > 1e9 / rate_hz ? 0 : config.spin_ns;
    if (config_check(&config) != HD_OK) {
        return HD_ERR_INVALID;
    }
    const int status = hd_servo_stop(servo); /* its force is fading already, or it has ended */
    if (status != HD_OK) {
        return status;
    }
    servo->config.overrun_action = config.overrun_action;
    servo->config.spin_ns = config.spin_ns;
    if (rate_hz != servo->config.rate_hz) {
        set_rate(servo, rate_hz);
        servo->new_rate_hz = rate_hz;
    }
    return HD_OK;
}

int hd_servo_restart(struct hd_servo *servo, uint32_t faults, struct hd_grant *grant) {
    *grant = (struct hd_grant){.memory = servo->memory_error, .memory_kind = servo->memory_kind};
    if (servo->started || !hd_atomic_u32_load_relaxed(&servo->overloaded)) {
        return hd_invalid("servo: can restart only after an overload");
    }
    struct hd_state *state = servo->state;
    hd_tick_silence(state); /* ringing modes are prepared for the old period */
    hd_state_want_forces(state, servo->wanted);
    if (faults != 0) {
        hd_state_latch(state, faults, 0, hd_clock_now_ns());
    }
    servo->stepping = 0;
    servo->ending = 0;
    servo->load_periods = 0;
    servo->load_missed = 0;
    servo->until_look = 0;
    servo->ticks_since_beat = 0;
    servo->pause_periods = 1u + (uint64_t)(servo->world->table.ramp_s / servo->period_s);
    hd_atomic_u32_store_relaxed(&servo->stopping, 0);
    hd_atomic_u32_store_relaxed(&servo->overloaded, 0);
    return launch(servo, grant);
}

void hd_servo_beat(struct hd_servo *servo) {
    hd_atomic_u64_add_relaxed(&servo->beat, 1);
}

void hd_servo_set_lease(struct hd_servo *servo, int64_t deadline_ns) {
    hd_atomic_i64_store_relaxed(&servo->lease_ns, deadline_ns);
}
