/* Making, switching and freeing a state; see hd_state.h for what it holds. */
#include "hd_state.h"

#include <math.h>
#include <stdlib.h>

struct hd_state *hd_state_new(uint32_t slot_capacity) {
    struct hd_state *state = calloc(1, sizeof *state);
    if (state == NULL) {
        return NULL;
    }
    state->slot_capacity = slot_capacity;
    state->slots = calloc(slot_capacity > 0 ? slot_capacity : 1, sizeof *state->slots);
    state->active = calloc(slot_capacity > 0 ? slot_capacity : 1, sizeof *state->active);
    state->voices = calloc(HD_VOICE_CAPACITY, sizeof *state->voices);
    state->strikes = calloc(HD_STRIKE_CAPACITY, sizeof *state->strikes);
    state->events = calloc(HD_EVENT_CAPACITY, sizeof *state->events);
    if (state->slots == NULL || state->active == NULL || state->voices == NULL || state->strikes == NULL ||
        state->events == NULL) {
        hd_state_free(state);
        return NULL;
    }
    state->enabled = 1;
    state->gain = 1.0;
    state->resync = 1;
    hd_velocity_init(&state->velocity, 0.0);
    return state;
}

void hd_state_free(struct hd_state *state) {
    if (state != NULL) {
        free(state->slots);
        free(state->active);
        free(state->voices);
        free(state->strikes);
        free(state->events);
        free(state);
    }
}

void hd_state_set_resolution(struct hd_state *state, double step_m) {
    hd_velocity_init(&state->velocity, step_m);
}

void hd_state_enable(struct hd_state *state, int enabled) {
    hd_state_want_forces(state, enabled);
}

uint32_t hd_state_faults(const struct hd_state *state) {
    return state->faults;
}

uint32_t hd_state_slot(const struct hd_state *state, uint32_t slot) {
    if (slot >= state->slot_capacity) {
        return 0;
    }
    return (uint32_t)state->slots[slot].touched | (uint32_t)state->slots[slot].open << 1;
}

HD_RT void hd_state_want_forces(struct hd_state *state, int enabled) {
    state->enabled = enabled && state->faults == 0;
}

HD_RT uint32_t hd_state_event(struct hd_state *state, uint32_t kind, int64_t time_ns) {
    if (state->event_count >= HD_EVENT_CAPACITY) {
        state->events_dropped++;
        return HD_EVENT_CAPACITY;
    }
    state->events[state->event_count] = (struct hd_event){
        .tick = state->tick,
        .time_ns = time_ns,
        .kind = kind,
        .slot = HD_NO_SLOT,
        .true_speed_m_per_s = (double)NAN,
    };
    return state->event_count++;
}

static HD_RT void report_faults(struct hd_state *state, int64_t time_ns) {
    const uint32_t event = hd_state_event(state, HD_EVENT_FAULT, time_ns);
    if (event < HD_EVENT_CAPACITY) {
        state->events[event].code = state->faults;
    }
}

HD_RT void hd_state_latch(struct hd_state *state, uint32_t faults, int at_once, int64_t time_ns) {
    state->enabled = 0;
    if (at_once) {
        state->gain = 0.0;
    }
    if ((state->faults | faults) != state->faults) {
        state->faults |= faults;
        report_faults(state, time_ns);
    }
}

HD_RT void hd_state_clear_faults(struct hd_state *state, uint32_t remaining, int64_t time_ns) {
    const uint32_t left = state->faults & remaining;
    if (left != state->faults) {
        state->faults = left;
        report_faults(state, time_ns);
    }
    hd_state_want_forces(state, 1);
}
