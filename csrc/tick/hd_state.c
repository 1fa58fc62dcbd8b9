/* Creating, copying and freeing a state; its members are described in hd_state.h. */
#include "tick/hd_state.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

/* Number of arrays with one entry per slot. */
#define SLOT_ARRAY_COUNT 5u

static size_t slot_regions(const struct hd_state *state, uint32_t from, uint32_t to, struct hd_region *regions) {
    const size_t count = to - from;
    regions[0] = (struct hd_region){state->slots + from, count * sizeof *state->slots};
    regions[1] = (struct hd_region){state->active + from, count * sizeof *state->active};
    regions[2] = (struct hd_region){state->resumed + from, count * sizeof *state->resumed};
    regions[3] = (struct hd_region){state->healing + from, count * sizeof *state->healing};
    regions[4] = (struct hd_region){state->candidates + from, count * sizeof *state->candidates};
    return SLOT_ARRAY_COUNT;
}

struct hd_state *hd_state_new(uint32_t slot_capacity) {
    struct hd_state *state = calloc(1, sizeof *state);
    if (state == NULL) {
        return NULL;
    }
    const size_t capacity = slot_capacity > 0 ? slot_capacity : 1;
    state->slot_capacity = slot_capacity;
    /* calloc of a large block takes address space only; a page gets memory when it is first touched. */
    state->slots = calloc(capacity, sizeof *state->slots);
    state->active = calloc(capacity, sizeof *state->active);
    state->resumed = calloc(capacity, sizeof *state->resumed);
    state->healing = calloc(capacity, sizeof *state->healing);
    state->candidates = calloc(capacity, sizeof *state->candidates);
    state->active_modes = calloc(HD_ACTIVE_MODE_CAPACITY, sizeof *state->active_modes);
    state->mode_ends = calloc(HD_ACTIVE_MODE_CAPACITY, sizeof *state->mode_ends);
    state->waves = calloc(HD_WAVE_CAPACITY, sizeof *state->waves);
    state->wave_blocks = calloc(HD_WAVE_CAPACITY, sizeof *state->wave_blocks);
    state->noises = calloc(HD_NOISE_CAPACITY, sizeof *state->noises);
    state->free_noises = calloc(HD_NOISE_CAPACITY, sizeof *state->free_noises);
    state->strikes = calloc(HD_STRIKE_CAPACITY, sizeof *state->strikes);
    state->events = calloc(HD_EVENT_CAPACITY + 1u, sizeof *state->events);
    if (state->slots == NULL || state->active == NULL || state->resumed == NULL || state->healing == NULL ||
        state->candidates == NULL || state->active_modes == NULL || state->mode_ends == NULL || state->waves == NULL ||
        state->wave_blocks == NULL || state->noises == NULL || state->free_noises == NULL || state->strikes == NULL ||
        state->events == NULL) {
        hd_state_free(state);
        return NULL;
    }
    for (uint32_t i = 0; i < HD_NOISE_CAPACITY; i++) {
        state->free_noises[i] = HD_NOISE_CAPACITY - 1u - i;
    }
    state->free_noise_count = HD_NOISE_CAPACITY;
    for (uint32_t i = 0; i < HD_WAVE_CAPACITY; i++) {
        state->waves[i].block = i;
    }
    state->enabled = 1;
    state->gain = 1.0;
    state->noise_gain = 1.0;
    state->ringing_gain = 1.0;
    state->epoch = 1;
    state->resync = 1;
    hd_velocity_init(&state->velocity, 0.0);
    return state;
}

void hd_state_free(struct hd_state *state) {
    if (state != NULL) {
        free(state->slots);
        free(state->active);
        free(state->resumed);
        free(state->healing);
        free(state->candidates);
        free(state->active_modes);
        free(state->mode_ends);
        free(state->waves);
        free(state->wave_blocks);
        free(state->noises);
        free(state->free_noises);
        free(state->strikes);
        free(state->events);
        free(state);
    }
}

int hd_state_reserve(struct hd_state *state, uint32_t slot_count) {
    if (slot_count > state->slot_capacity) {
        return hd_invalid("table: %u objects, but the state has room for %u", slot_count, state->slot_capacity);
    }
    if (slot_count > state->slot_count) {
        struct hd_region regions[SLOT_ARRAY_COUNT];
        hd_memory_touch(regions, slot_regions(state, state->slot_count, slot_count, regions));
        state->slot_count = slot_count;
    }
    return HD_OK;
}

uint32_t hd_state_slot_count(const struct hd_state *state) {
    return state->slot_count;
}

size_t hd_state_regions(const struct hd_state *state, uint32_t from_slot, uint32_t to_slot, struct hd_region *regions) {
    size_t count = slot_regions(state, from_slot, to_slot, regions);
    if (from_slot == 0) {
        regions[count++] = (struct hd_region){(void *)(uintptr_t)state, sizeof *state};
        regions[count++] =
            (struct hd_region){state->active_modes, HD_ACTIVE_MODE_CAPACITY * sizeof *state->active_modes};
        regions[count++] = (struct hd_region){state->mode_ends, HD_ACTIVE_MODE_CAPACITY * sizeof *state->mode_ends};
        regions[count++] = (struct hd_region){state->waves, HD_WAVE_CAPACITY * sizeof *state->waves};
        regions[count++] = (struct hd_region){state->wave_blocks, HD_WAVE_CAPACITY * sizeof *state->wave_blocks};
        regions[count++] = (struct hd_region){state->noises, HD_NOISE_CAPACITY * sizeof *state->noises};
        regions[count++] = (struct hd_region){state->free_noises, HD_NOISE_CAPACITY * sizeof *state->free_noises};
        regions[count++] = (struct hd_region){state->strikes, HD_STRIKE_CAPACITY * sizeof *state->strikes};
        regions[count++] = (struct hd_region){state->events, (HD_EVENT_CAPACITY + 1u) * sizeof *state->events};
    }
    return count;
}

int hd_state_copy(struct hd_state *to, const struct hd_state *from) {
    if (to->slot_capacity != from->slot_capacity) {
        return hd_invalid("state: %u slots do not fit into %u", from->slot_capacity, to->slot_capacity);
    }
    const int status = hd_state_reserve(to, from->slot_count);
    if (status != HD_OK) {
        return status;
    }
    const struct hd_state own = *to;
    *to = *from;
    to->slots = own.slots;
    to->active = own.active;
    to->resumed = own.resumed;
    to->healing = own.healing;
    to->candidates = own.candidates;
    to->active_modes = own.active_modes;
    to->mode_ends = own.mode_ends;
    to->waves = own.waves;
    to->wave_blocks = own.wave_blocks;
    to->noises = own.noises;
    to->free_noises = own.free_noises;
    to->strikes = own.strikes;
    to->events = own.events;
    to->slot_count = own.slot_count;
    memcpy(to->slots, from->slots, from->slot_count * sizeof *to->slots);
    memcpy(to->active, from->active, from->active_count * sizeof *to->active);
    memcpy(to->resumed, from->resumed, from->resumed_count * sizeof *to->resumed);
    memcpy(to->healing, from->healing, from->healing_count * sizeof *to->healing);
    memcpy(to->candidates, from->candidates, from->candidate_count * sizeof *to->candidates);
    memcpy(to->active_modes, from->active_modes, from->active_mode_count * sizeof *to->active_modes);
    memcpy(to->mode_ends, from->mode_ends, from->active_mode_count * sizeof *to->mode_ends);
    memcpy(to->waves, from->waves, HD_WAVE_CAPACITY * sizeof *to->waves);
    for (uint32_t i = 0; i < from->wave_count; i++) {
        to->wave_blocks[from->waves[i].block] = from->wave_blocks[from->waves[i].block];
    }
    memcpy(to->free_noises, from->free_noises, HD_NOISE_CAPACITY * sizeof *to->free_noises);
    memcpy(to->events, from->events, from->event_count * sizeof *to->events);
    for (uint32_t i = 0; i < from->active_count; i++) {
        const uint32_t noise = from->slots[from->active[i]].noise;
        if (noise != 0) {
            to->noises[noise - 1] = from->noises[noise - 1];
        }
    }
    /* Between two ticks strikes[] holds only strikes of hd_tick_play, whose modes are in played[]. */
    for (uint32_t i = 0; i < from->strike_count; i++) {
        to->strikes[i] = from->strikes[i];
        to->strikes[i].mode = to->played + (from->strikes[i].mode - from->played);
    }
    return HD_OK;
}

void hd_state_set_resolution(struct hd_state *state, double step_m) {
    hd_velocity_init(&state->velocity, step_m);
}

void hd_state_enable(struct hd_state *state, int enabled) {
    hd_state_want_forces(state, enabled);
}

void hd_state_mute(struct hd_state *state) {
    state->gain = 0.0;
}

uint32_t hd_state_faults(const struct hd_state *state) {
    return state->faults;
}

uint32_t hd_state_slot(const struct hd_state *state, uint32_t slot) {
    if (slot >= state->slot_capacity) {
        return 0;
    }
    const struct hd_slot *found = &state->slots[slot];
    return (uint32_t)found->touched | (found->open == state->epoch ? 2u : 0u);
}

void hd_state_energy(const struct hd_state *state, struct hd_energy *energy) {
    const struct hd_passivity *passivity = &state->passivity;
    *energy = (struct hd_energy){
        .energy_j = passivity->energy_j,
        .largest_j = passivity->largest_j,
        .contacts = passivity->contacts,
        .restrained = passivity->restrained,
        .acted = passivity->acted,
    };
}

HD_RT void hd_state_want_forces(struct hd_state *state, int enabled) {
    state->enabled = enabled && state->faults == 0;
}

HD_RT struct hd_event *hd_event_add(struct hd_state *state, uint32_t kind, int64_t time_ns, uint32_t code,
                                    double value) {
    struct hd_event *event = &state->events[state->event_count];
    if (state->event_count < HD_EVENT_CAPACITY) {
        state->event_count++;
    } else {
        state->events_dropped++;
    }
    *event = (struct hd_event){
        .tick = state->tick,
        .time_ns = time_ns,
        .kind = kind,
        .code = code,
        .slot = HD_NO_SLOT,
        .true_speed_m_per_s = (double)NAN,
        .value = value,
    };
    return event;
}

HD_RT struct hd_event *hd_event_add_at(struct hd_state *state, uint32_t kind, int64_t time_ns, uint32_t slot) {
    struct hd_event *event = hd_event_add(state, kind, time_ns, 0, 0.0);
    event->slot = slot;
    event->generation = state->slots[slot].generation;
    return event;
}

HD_RT void hd_state_latch(struct hd_state *state, uint32_t faults, int at_once, int64_t time_ns) {
    state->enabled = 0;
    if (at_once) {
        state->gain = 0.0;
    }
    if ((state->faults | faults) != state->faults) {
        state->faults |= faults;
        hd_event_add(state, HD_EVENT_FAULT, time_ns, state->faults, 0.0);
    }
}

HD_RT void hd_state_clear_faults(struct hd_state *state, uint32_t remaining, int64_t time_ns) {
    const uint32_t kept = state->faults & remaining;
    if (kept != state->faults) {
        state->faults = kept;
        hd_event_add(state, HD_EVENT_FAULT, time_ns, state->faults, 0.0);
    }
    hd_state_want_forces(state, 1);
}
