/* Time of the simulated joystick: advances from event to event. An event splits a period: the hand's reference enters
 * another segment, the force expires, another force takes effect, or an encoder sample is due. The motion between two
 * events is computed by hd_sim_solver.c.
 *
 * Through a link a force takes effect at a later frame. That frame is known when the force is put, so the forces under
 * way are a short queue of forces and times, each of them an event. A put before the frame of the last one has left
 * replaces that one. */
#include "device/hd_sim_state.h"

#include <math.h>
#include <stddef.h>

#include "base/hd_cache.h"
#include "base/hd_vector.h"

/* Adding and subtracting this number rounds to the nearest integer, up to 2^51. */
#define HD_ROUND_MAGIC 6755399441055744.0

/* ---- Time ------------------------------------------------------------------------------------------------------ */

HD_RT double hd_sim_path_time_s(const struct hd_sim *sim) {
    return (double)(int64_t)(sim->tick - sim->path_tick) * sim->period_s;
}

/* Advances both axes by `span_s` within the segment, under a constant force. */
HD_RT static void advance_span(struct hd_sim *sim, double local_s, double span_s) {
    double limit_s = sim->segment_limit_s;
    if (hd_sim_lags(sim) && sim->lag_limit_s < limit_s) {
        limit_s = sim->lag_limit_s;
    }
    const double wanted = span_s / limit_s;
    uint32_t parts = (uint32_t)wanted;
    parts += (double)parts < wanted;
    const double part_s = span_s / (double)parts;
    struct hd_kernel made;
    const struct hd_kernel *kernel = &made;
    if (part_s == sim->period.span_s) {
        kernel = &sim->period;
    } else if (part_s == sim->stretch.span_s) {
        kernel = &sim->stretch;
    } else if (part_s == sim->lagging.span_s) {
        kernel = &sim->lagging;
    } else {
        hd_sim_kernel_at(sim, part_s, &made);
    }
    for (uint32_t part = 0; part < parts; part++) {
        const double part_local_s = local_s + (double)part * part_s;
        hd_sim_solve(sim, part_local_s, kernel);
    }
}

/* Prepares the steps of the new sim->segment. */
HD_RT static void begin_segment(struct hd_sim *sim) {
    sim->segment_limit_s = sim->limit_s;
    if (sim->segment.profile == HD_PROFILE_MINIMUM_JERK && sim->segment.duration_s < 8.0 * sim->limit_s) {
        sim->segment_limit_s = sim->segment.duration_s / 8.0;
    }
    sim->calm_tick = UINT64_MAX;
    if (sim->segment.profile == HD_PROFILE_HOLD) {
        sim->path = NULL;
    } else {
        sim->calm_tick = sim->path_tick + (uint64_t)(sim->segment.end_s / sim->period_s + HD_SAME_TIME);
    }
    if (sim->period_s > sim->segment_limit_s) {
        sim->calm_tick = 0;
    }
}

HD_RT static void enter_segment(struct hd_sim *sim, const double reference_m[2]) {
    hd_operator_segment(sim->path, sim->path_index, reference_m, &sim->segment);
    begin_segment(sim);
}

/* Rests at a streamed target after the line that leads to it. */
HD_RT static void arrive_at_target(struct hd_sim *sim) {
    hd_operator_rest(sim->target_m, sim->segment.end_s, &sim->segment);
    begin_segment(sim);
}

/* Finds the segment that contains the time `path_s`, or begins there. */
HD_RT static void find_segment(struct hd_sim *sim, double path_s) {
    while (path_s >= sim->segment.end_s - HD_SAME_TIME * sim->period_s) {
        if (sim->path == NULL) {
            arrive_at_target(sim);
        } else {
            sim->path_index++;
            enter_segment(sim, sim->segment.from_m);
        }
    }
}

/* Returns the time from the present tick to the expiry of the force; infinite for a force of zero. */
HD_RT static double force_left_s(const struct hd_sim *sim) {
    if (sim->force_n[0] == 0.0 && sim->force_n[1] == 0.0) {
        return (double)INFINITY;
    }
    const double held_s = (double)(int64_t)(sim->tick - sim->put_tick) * sim->period_s - sim->put_late_s;
    const double left_s = sim->force_timeout_s - held_s;
    return left_s > HD_SAME_TIME * sim->period_s ? left_s : 0.0;
}

HD_RT static bool force_lasts(const struct hd_sim *sim) {
    return sim->tick - sim->put_tick < sim->force_whole_periods || (sim->force_n[0] == 0.0 && sim->force_n[1] == 0.0);
}

HD_RT static double quantised(const struct hd_sim *sim, double x) {
    if (sim->encoder_step_m == 0.0) {
        return x;
    }
    return ((x * sim->encoder_per_m + HD_ROUND_MAGIC) - HD_ROUND_MAGIC) * sim->encoder_step_m;
}

HD_RT void hd_sim_sample(struct hd_sim *sim) {
    struct hd_encoder_sample *to = &sim->samples[sim->sample_count & sim->sample_mask];
    for (int which = 0; which < 2; which++) {
        to->position_m[which] = quantised(sim, sim->axes[which].x);
        to->velocity_m_per_s[which] = sim->axes[which].v;
    }
    sim->sample_count++;
    sim->sample_at += sim->sample_interval;
}

/* Makes the first of the forces under way take effect, `late_s` after the present tick. */
HD_RT static void take_force_effect(struct hd_sim *sim, double late_s) {
    const struct hd_sent *const first = &sim->sent[sim->sent_first];
    hd_sim_set_force(sim, first->force_n[0], first->force_n[1]);
    sim->put_tick = sim->tick;
    sim->put_late_s = late_s;
    sim->sent_first = (sim->sent_first + 1u) % HD_SIM_FORCES;
    sim->sent_count--;
    sim->arrive_at = sim->sent_count > 0 ? sim->sent[sim->sent_first].at : UINT64_MAX;
}

/* Takes the sample and the force that are due at a tick. */
HD_RT static inline void take_due(struct hd_sim *sim, uint64_t now) {
    if (sim->sample_at == now) {
        hd_sim_sample(sim);
    }
    if (sim->arrive_at == now) {
        take_force_effect(sim, 0.0);
    }
}

/* Returns the time from `begin`, the start of the present period, to `at`, in s. */
HD_RT static inline double within_s(const struct hd_sim *sim, uint64_t at, uint64_t begin) {
    return (double)(int64_t)(at - begin) * HD_FRACTION_UNIT * sim->period_s;
}

/* Advances by one period with all events in it. */
HD_RT static void busy_period(struct hd_sim *sim) {
    const uint64_t begin = (sim->tick - sim->origin_tick) << HD_FRACTION_SHIFT;
    const uint64_t end = begin + ((uint64_t)1 << HD_FRACTION_SHIFT);
    const double path_s = hd_sim_path_time_s(sim);
    double done_s = 0.0;
    while (done_s < sim->period_s) {
        double next_s = sim->period_s;
        bool samples = false;
        bool arrives = false;
        find_segment(sim, path_s + done_s);
        if (sim->segment.end_s - path_s < next_s - HD_SAME_TIME * sim->period_s) {
            next_s = sim->segment.end_s - path_s;
        }
        const double expiry_s = force_left_s(sim);
        if (expiry_s <= done_s) {
            hd_sim_set_force(sim, 0.0, 0.0);
        } else if (expiry_s < next_s - HD_SAME_TIME * sim->period_s) {
            next_s = expiry_s;
        }
        if (sim->sample_at < end) {
            const double sample_s = within_s(sim, sim->sample_at, begin);
            if (sample_s <= next_s) {
                next_s = sample_s;
                samples = true;
            }
        }
        if (sim->arrive_at < end) {
            const double arrive_s = within_s(sim, sim->arrive_at, begin);
            if (arrive_s <= next_s) {
                samples = samples && arrive_s == next_s;
                next_s = arrive_s;
                arrives = true;
            }
        }
        if (next_s > done_s) {
            advance_span(sim, path_s + done_s - sim->segment.start_s, next_s - done_s);
            done_s = next_s;
        }
        if (samples) {
            hd_sim_sample(sim);
        }
        if (arrives) {
            take_force_effect(sim, next_s);
        }
    }
    sim->tick++;
    take_due(sim, end);
}

HD_RT static inline void one_period(struct hd_sim *sim) {
    const uint64_t end = (sim->tick + 1u - sim->origin_tick) << HD_FRACTION_SHIFT;
    if (sim->tick >= sim->calm_tick || !force_lasts(sim) || sim->sample_at < end || sim->arrive_at < end ||
        hd_sim_lags(sim)) {
        busy_period(sim);
        return;
    }
    const double local_s = hd_sim_path_time_s(sim) - sim->segment.start_s;
    hd_sim_solve(sim, local_s, &sim->period);
    sim->tick++;
    take_due(sim, end);
}

/* Returns how many periods can be one step: no event is inside of them, and at most an encoder sample and a force at
 * their end. */
HD_RT static uint64_t free_periods(const struct hd_sim *sim, uint64_t end_tick) {
    if (sim->tick >= sim->calm_tick || !force_lasts(sim) || hd_sim_lags(sim)) {
        return 0;
    }
    uint64_t count = end_tick - sim->tick;
    if (sim->calm_tick - sim->tick < count) {
        count = sim->calm_tick - sim->tick;
    }
    if (sim->force_n[0] != 0.0 || sim->force_n[1] != 0.0) {
        const uint64_t lasting = sim->force_whole_periods - (sim->tick - sim->put_tick);
        count = lasting < count ? lasting : count;
    }
    const uint64_t next_at = sim->sample_at < sim->arrive_at ? sim->sample_at : sim->arrive_at;
    const uint64_t silent = (next_at - ((sim->tick - sim->origin_tick) << HD_FRACTION_SHIFT)) >> HD_FRACTION_SHIFT;
    return silent < count ? silent : count;
}

/* Advances by many periods in as few steps as the device allows, and without a step once the handle rests. */
HD_RT static void many_periods(struct hd_sim *sim, uint32_t periods) {
    const uint64_t end_tick = sim->tick + periods;
    const uint64_t end = (end_tick - sim->origin_tick) << HD_FRACTION_SHIFT;
    if (end >= sim->sample_delay) {
        /* Samples older than the newest one that can be read at the end are never read. */
        const uint64_t newest = (end - sim->sample_delay) / sim->sample_interval;
        if (newest > sim->sample_count) {
            sim->sample_count = newest;
            sim->sample_at = newest * sim->sample_interval;
        }
    }
    while (sim->tick < end_tick) {
        find_segment(sim, hd_sim_path_time_s(sim));
        uint64_t count = free_periods(sim, end_tick);
        if (count < 2) {
            one_period(sim);
            continue;
        }
        const struct hd_axis before[2] = {sim->axes[0], sim->axes[1]};
        const uint64_t step = count < sim->stretch_periods ? count : sim->stretch_periods;
        advance_span(sim, hd_sim_path_time_s(sim) - sim->segment.start_s, (double)(int64_t)step * sim->period_s);
        const bool rests = sim->segment.profile == HD_PROFILE_HOLD && before[0].x == sim->axes[0].x &&
                           before[0].v == sim->axes[0].v && before[1].x == sim->axes[1].x &&
                           before[1].v == sim->axes[1].v;
        sim->tick += rests ? count : step;
        take_due(sim, (sim->tick - sim->origin_tick) << HD_FRACTION_SHIFT);
    }
}

HD_RT void hd_sim_step_advance(struct hd_sim *sim, uint32_t periods) {
    if (periods == 1) {
        one_period(sim);
    } else {
        many_periods(sim, periods);
    }
}

/* ---- Force, reference and encoder samples ------------------------------------------------------------------------ */

/* Sends a force with the next frame; a force that waited for the same frame is replaced. */
HD_RT static void send_force(struct hd_sim *sim, const double force_n[2]) {
    const uint64_t now = (sim->tick - sim->origin_tick) << HD_FRACTION_SHIFT;
    const uint64_t at = (now / sim->force_interval + sim->force_intervals) * sim->force_interval;
    uint32_t last = (sim->sent_first + sim->sent_count + HD_SIM_FORCES - 1u) % HD_SIM_FORCES;
    if (sim->sent_count == 0 || sim->sent[last].at != at) {
        last = (last + 1u) % HD_SIM_FORCES;
        sim->sent_count++;
    }
    sim->sent[last] = (struct hd_sent){{force_n[0], force_n[1]}, at};
    sim->arrive_at = sim->sent[sim->sent_first].at;
}

HD_RT void hd_sim_step_put(struct hd_sim *sim, const double force_n[2]) {
    double shown_n[2];
    const bool finite = isfinite(force_n[0]) && isfinite(force_n[1]);
    for (int which = 0; which < 2; which++) {
        double level = finite ? force_n[which] : 0.0;
        if (sim->force_step_n > 0.0) {
            /* Limited before it is rounded, because the rounding needs less than 2^51 steps. */
            level *= sim->force_per_n;
            level = level > sim->force_top ? sim->force_top : level;
            level = level < -sim->force_top ? -sim->force_top : level;
            shown_n[which] = ((level + HD_ROUND_MAGIC) - HD_ROUND_MAGIC) * sim->force_step_n;
        } else {
            level = level > sim->force_top ? sim->force_top : level;
            shown_n[which] = level < -sim->force_top ? -sim->force_top : level;
        }
    }
    if (sim->force_interval > 0) {
        send_force(sim, shown_n);
        return;
    }
    hd_sim_set_force(sim, shown_n[0], shown_n[1]);
    sim->put_tick = sim->tick;
}

HD_RT void hd_sim_reference(struct hd_sim *sim, double reference_m[2]) {
    const double path_s = hd_sim_path_time_s(sim);
    find_segment(sim, path_s);
    for (int which = 0; which < 2; which++) {
        double reference[HD_REFERENCE_ORDERS];
        hd_segment_reference(&sim->segment, which, path_s - sim->segment.start_s, reference);
        reference_m[which] = reference[0];
    }
}

HD_RT void hd_sim_step_operate(struct hd_sim *sim, const struct hd_operator *path) {
    double reference_m[2];
    hd_sim_reference(sim, reference_m);
    sim->path = path;
    sim->path_index = hd_operator_first(path);
    sim->path_tick = sim->tick;
    sim->path_end_s = path->waypoints[path->count - 1][0];
    sim->path_announced = false;
    enter_segment(sim, reference_m);
    find_segment(sim, 0.0);
}

HD_RT int hd_sim_step_lead(struct hd_sim *sim, const double target_m[2], double duration_s) {
    double reference_m[2] = {0.0, 0.0}; // gcc's analyser cannot see that both are written
    hd_sim_reference(sim, reference_m);
    const double fastest_s = hd_distance(reference_m, target_m) / (double)HD_STREAM_MAX_M_PER_S;
    const int limited = fastest_s > duration_s * (1.0 + HD_SAME_TIME);
    sim->path = NULL;
    sim->path_tick = sim->tick;
    sim->path_announced = true;
    sim->target_m[0] = target_m[0];
    sim->target_m[1] = target_m[1];
    hd_operator_line(reference_m, target_m, limited ? fastest_s : duration_s, &sim->segment);
    begin_segment(sim);
    return limited;
}

HD_RT enum hd_progress hd_sim_step_progress(const struct hd_sim *sim) {
    if (sim->path_announced) {
        return HD_PROGRESS_NONE;
    }
    return hd_sim_path_time_s(sim) < sim->path_end_s - HD_SAME_TIME * sim->period_s ? HD_PROGRESS_UNDER_WAY
                                                                                    : HD_PROGRESS_THROUGH;
}

HD_RT void hd_sim_step_announced(struct hd_sim *sim) {
    sim->path_announced = true;
}

HD_RT void hd_sim_step_read(struct hd_sim *sim, struct hd_reading *reading) {
    const uint64_t now = (sim->tick - sim->origin_tick) << HD_FRACTION_SHIFT;
    reading->interval_s = 0.0;
    if (now >= sim->read_next_at) {
        const uint64_t late = now - sim->read_next_at;
        const uint64_t ahead = late < sim->sample_interval ? 1u : 1u + late / sim->sample_interval;
        sim->read_number += ahead;
        sim->read_next_at += ahead * sim->sample_interval;
        if (sim->read_before) {
            reading->interval_s = (double)(int64_t)ahead * sim->sample_interval_s;
        }
    }
    sim->read_before = true;
    const struct hd_encoder_sample *from = &sim->samples[sim->read_number & sim->sample_mask];
    for (int which = 0; which < 2; which++) {
        reading->position_m[which] = from->position_m[which];
        reading->true_velocity_m_per_s[which] = from->velocity_m_per_s[which];
    }
}

HD_RT void hd_sim_step_fetch(const struct hd_sim *sim) {
    hd_cache_fetch(sim, offsetof(struct hd_sim, path));
    hd_cache_fetch(&sim->samples[sim->sample_count & sim->sample_mask], sizeof sim->samples[0]);
}

HD_RT void hd_sim_step_truth(const struct hd_sim *sim, double position[2], double velocity[2], double force[2]) {
    /* The force of a lagging actuator begins to fall then. */
    const bool expired = force_left_s(sim) == 0.0 && sim->actuator.order == 0;
    for (int which = 0; which < 2; which++) {
        position[which] = sim->axes[which].x;
        velocity[which] = sim->axes[which].v;
        force[which] = (expired ? 0.0 : sim->force_n[which]) + sim->off[which].off_n;
    }
}
