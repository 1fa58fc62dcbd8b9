/* Ringing modes, Q(t) = A exp(-B t) sin(w t) for 0 <= t <= 5/B, then exactly zero.
 *
 * A mode that is compensated for the device starts with gain * A instead of A, where gain is a complex number. It can
 * have a tail, or two: further active modes, struck together with the first, each with a separate decay and end.
 *
 * Each mode is z[k+1] = z[k] exp((-B + i w) T) with the output Im z. This is the closed form of the sampled signal, so
 * the only error is rounding, about k eps after k ticks. z has a component along x and one along y; one rotor turns
 * both, so strikes along any direction add linearly. A mode ends after a number of ticks that is computed from the
 * closed form at the strike, not by its amplitude. e^-5 of a strike is far above subnormal numbers; strikes that could
 * become subnormal are ignored.
 *
 * A tick visits the active modes once: the loop that rotates them also sums them, and a strike adds its part to the
 * sum. An active mode fills one cache line, and x and y are computed as one vector. */
#include "tick/hd_mode.h"

#include <math.h>

#include "tick/hd_strike_correction.h"
#include "tick/hd_waveform.h"

/* Squares of coefficients below this, N^2, could become subnormal. A coefficient of 1e-145 N cannot be felt. */
#define HD_SMALLEST_SQUARE 1e-290
/* Largest number of modes that a search compares, so that the work of a strike is bounded. */
#define HD_MODES_COMPARED_MAX 16u
#define HD_END_ROUNDING 1e-12 /* relative: covers the rounding of a period, of 5/B and of their multiples */

/* A part of a strike: the mode, or the tail of the mode. */
struct component {
    double rotor_re;
    double rotor_im;
    double decay_rate_per_s;
    double angular_frequency_rad_per_s;
    double end_s;
    double gain_re;
    double gain_im;
    uint32_t use;
};

/* Returns the member of a slot that starts the chain of its active modes for `use`. */
HD_RT static uint32_t *first_link(struct hd_slot *slot, uint32_t use) {
    if (use >= 2u * HD_MODE_USES) {
        return &slot->preloaded;
    }
    return use < HD_MODE_USES ? &slot->mode[use] : &slot->tail[use - HD_MODE_USES];
}

/* Returns the link of the slot's chain that refers to an active mode; NULL if no chain does. */
HD_RT static uint32_t *find_link(struct hd_state *state, uint32_t index) {
    const struct hd_active_mode *active = &state->active_modes[index];
    if (active->slot >= state->slot_capacity) {
        return NULL;
    }
    uint32_t *link = first_link(&state->slots[active->slot], active->use);
    while (*link != 0 && *link != index + 1u) {
        link = &state->mode_ends[*link - 1u].next;
    }
    return *link != 0 ? link : NULL;
}

HD_RT static void remove_mode(struct hd_state *state, uint32_t index) {
    uint32_t *link = find_link(state, index);
    if (link != NULL) {
        *link = state->mode_ends[index].next;
    }
    const uint32_t last = --state->active_mode_count;
    if (index != last) {
        link = find_link(state, last);
        if (link != NULL) {
            *link = index + 1u;
        }
        state->active_modes[index] = state->active_modes[last];
        state->mode_ends[index] = state->mode_ends[last];
    }
}

HD_RT static void exp_complex(double magnitude_log, double angle, double *re, double *im) {
    HD_RT_FOREIGN_BEGIN
    const double magnitude = exp(magnitude_log);
    *re = magnitude * cos(angle);
    *im = magnitude * sin(angle);
    HD_RT_FOREIGN_END
}

/* Computes z^exponent by squaring. The relative error is about `exponent` eps, as with single ticks. */
HD_RT static void complex_power(uint32_t exponent, double *re, double *im) {
    double square_re = *re;
    double square_im = *im;
    *re = 1.0;
    *im = 0.0;
    for (; exponent > 0; exponent >>= 1) {
        if (exponent & 1u) {
            const double whole = *re * square_re - *im * square_im;
            *im = *re * square_im + *im * square_re;
            *re = whole;
        }
        const double turned = square_re * square_re - square_im * square_im;
        square_im *= 2.0 * square_re;
        square_re = turned;
    }
}

HD_RT static void rotate(struct hd_active_mode *active, uint32_t periods) {
    double rotor_re = active->rotor_re;
    double rotor_im = active->rotor_im;
    if (periods != 1) {
        complex_power(periods, &rotor_re, &rotor_im);
    }
    const hd_pair re = active->re;
    const hd_pair im = active->im;
    active->re = re * rotor_re - im * rotor_im;
    active->im = re * rotor_im + im * rotor_re;
}

/* Ends a mode and moves it behind those that ring, since the onset of a strike of this tick can precede its end. */
HD_RT static void end_mode(struct hd_state *state, uint32_t index, uint32_t periods) {
    struct hd_active_mode active = state->active_modes[index];
    struct hd_mode_end end = state->mode_ends[index];
    if (active.remaining + 1u == periods) {
        rotate(&active, periods);
    } else {
        end.over_s = (double)INFINITY; /* ended before any strike of this tick */
    }
    remove_mode(state, index);
    state->active_modes[state->active_mode_count] = active;
    state->mode_ends[state->active_mode_count] = end;
    state->ended_count++;
}

HD_RT void hd_modes_advance(struct hd_state *state, uint32_t periods) {
    hd_pair sum = {0.0, 0.0};
    uint32_t i = 0;
    while (i < state->active_mode_count) {
        struct hd_active_mode *active = &state->active_modes[i];
        if (active->remaining < periods) {
            end_mode(state, i, periods);
            continue;
        }
        active->remaining -= periods;
        rotate(active, periods);
        sum += active->im;
        i++;
    }
    state->ringing_n[0] = sum[0];
    state->ringing_n[1] = sum[1];
    if (state->kick_count > 0) {
        hd_strike_correction_advance(state, periods);
    }
    if (state->wave_count > 0) {
        hd_waves_advance(state, periods);
    }
}

HD_RT double hd_modes_bound(const struct hd_state *state) {
    double bound = 0.0;
    for (uint32_t i = 0; i < state->active_mode_count; i++) {
        const struct hd_active_mode *active = &state->active_modes[i];
        HD_RT_FOREIGN_BEGIN
        bound += sqrt(active->re[0] * active->re[0] + active->im[0] * active->im[0] + active->re[1] * active->re[1] +
                      active->im[1] * active->im[1]);
        HD_RT_FOREIGN_END
    }
    bound = state->kick_count > 0 ? bound + hd_strike_correction_bound(state) : bound;
    return state->wave_count > 0 ? bound + hd_waves_bound(state) : bound;
}

/* Returns the end of a mode plus a tolerance, so that a tick exactly at the end sounds. */
HD_RT static double rounded_end(double end_s) {
    return end_s * (1.0 + HD_END_ROUNDING);
}

/* Returns the number of ticks after that of the strike in which the mode sounds: the largest n with n T + tau <= 5/B;
 * -1 if n = 0 is too late already. */
HD_RT static int64_t ticks_remaining(double mode_end_s, double before_s, double period_s) {
    const double end_s = rounded_end(mode_end_s);
    if (!(before_s <= end_s)) {
        return -1;
    }
    const double estimate = (end_s - before_s) / period_s;
    if (estimate >= (double)UINT32_MAX) {
        return UINT32_MAX;
    }
    int64_t n = (int64_t)estimate;
    while ((double)(n + 1) * period_s + before_s <= end_s) {
        n++;
    }
    while (n > 0 && (double)n * period_s + before_s > end_s) {
        n--;
    }
    return n;
}

HD_RT static int is_active_of(const struct hd_active_mode *active, const struct hd_strike *strike,
                              const struct component *part) {
    return active->slot == strike->slot && active->generation == strike->generation && active->use == part->use &&
           active->rotor_re == part->rotor_re && active->rotor_im == part->rotor_im;
}

/* Finds the active mode to which a strike is added: it has the same slot, use and rotor. A mode struck by `play` has no
 * slot and is compared with all active modes. Modes of other materials of the slot ring separately. */
HD_RT static struct hd_active_mode *find_active(struct hd_state *state, const struct hd_strike *strike,
                                                const struct component *part) {
    if (strike->slot < state->slot_capacity) {
        uint32_t *link = first_link(&state->slots[strike->slot], part->use);
        for (uint32_t passed = 1; *link != 0; passed++) {
            struct hd_active_mode *active = &state->active_modes[*link - 1u];
            if (is_active_of(active, strike, part)) {
                return active;
            }
            if (passed == HD_MODES_COMPARED_MAX) { /* bounds the chain; the mode rings on without a link */
                active->slot = HD_NO_SLOT;
                *link = 0;
                break;
            }
            link = &state->mode_ends[*link - 1u].next;
        }
        return NULL;
    }
    for (uint32_t i = 0; i < state->active_mode_count; i++) {
        struct hd_active_mode *active = &state->active_modes[i];
        if (is_active_of(active, strike, part)) {
            return active;
        }
    }
    return NULL;
}

/* Adds the continuation of a mode that ended since the last tick, if this strike came before its end. */
HD_RT static void revive(struct hd_state *state, const struct hd_strike *strike, const struct component *part,
                         hd_pair *re, hd_pair *im) {
    const uint32_t count = state->ended_count < HD_MODES_COMPARED_MAX ? state->ended_count : HD_MODES_COMPARED_MAX;
    for (uint32_t i = state->active_mode_count; i < state->active_mode_count + count; i++) {
        if (is_active_of(&state->active_modes[i], strike, part) && state->mode_ends[i].over_s <= strike->before_s) {
            *re += state->active_modes[i].re;
            *im += state->active_modes[i].im;
            state->mode_ends[i].over_s = (double)INFINITY;
        }
    }
}

HD_RT static struct hd_active_mode *new_active(struct hd_state *state, const struct hd_strike *strike, uint32_t use) {
    if (state->active_mode_count == HD_ACTIVE_MODE_CAPACITY) {
        /* Replaces the mode nearest its end among a few, so that a tick with thousands of strikes has bounded work. */
        uint32_t nearest = state->strike_count % HD_ACTIVE_MODE_CAPACITY;
        for (uint32_t i = 1; i < HD_MODES_COMPARED_MAX; i++) {
            const uint32_t other = (nearest + 257u * i) % HD_ACTIVE_MODE_CAPACITY;
            if (state->active_modes[other].remaining < state->active_modes[nearest].remaining) {
                nearest = other;
            }
        }
        state->ringing_n[0] -= state->active_modes[nearest].im[0];
        state->ringing_n[1] -= state->active_modes[nearest].im[1];
        remove_mode(state, nearest);
    }
    const uint32_t index = state->active_mode_count++;
    const uint32_t behind = index + state->ended_count;
    if (state->ended_count > 0 && behind < HD_ACTIVE_MODE_CAPACITY) {
        state->active_modes[behind] = state->active_modes[index];
        state->mode_ends[behind] = state->mode_ends[index];
    } else if (state->ended_count > 0) {
        state->ended_count--;
    }
    state->active_modes[index] =
        (struct hd_active_mode){.slot = strike->slot, .generation = strike->generation, .use = use};
    state->mode_ends[index] = (struct hd_mode_end){.over_s = (double)INFINITY};
    if (strike->slot < state->slot_capacity) {
        uint32_t *first = first_link(&state->slots[strike->slot], use);
        state->mode_ends[index].next = *first;
        *first = index + 1u;
    }
    return &state->active_modes[index];
}

HD_RT static void strike_part(struct hd_state *state, const struct hd_strike *strike, const struct component *part,
                              const double force_n[2], double period_s) {
    const int64_t remaining = ticks_remaining(part->end_s, strike->before_s, period_s);
    const double gain = part->gain_re * part->gain_re + part->gain_im * part->gain_im;
    const double square = gain * (force_n[0] * force_n[0] + force_n[1] * force_n[1]);
    if (remaining < 0 || !(square > HD_SMALLEST_SQUARE)) {
        return; /* ended before this tick, or too small */
    }
    struct hd_active_mode *active = find_active(state, strike, part);
    if (active == NULL) {
        hd_pair re = {0.0, 0.0};
        hd_pair im = {0.0, 0.0};
        revive(state, strike, part, &re, &im);
        active = new_active(state, strike, part->use);
        active->rotor_re = part->rotor_re;
        active->rotor_im = part->rotor_im;
        active->re = re;
        active->im = im;
        state->ringing_n[0] += im[0];
        state->ringing_n[1] += im[1];
    }
    /* The mode ends five time constants after the last of several strikes, which can come in any order. */
    struct hd_mode_end *end = &state->mode_ends[active - state->active_modes];
    const double over_s = (double)(remaining + 1) * period_s + strike->before_s - rounded_end(part->end_s);
    if ((uint32_t)remaining > active->remaining || ((uint32_t)remaining == active->remaining && over_s < end->over_s)) {
        active->remaining = (uint32_t)remaining;
        end->over_s = over_s;
    }
    double turned_re;
    double turned_im;
    exp_complex(-part->decay_rate_per_s * strike->before_s, part->angular_frequency_rad_per_s * strike->before_s,
                &turned_re, &turned_im);
    const double re = part->gain_re * turned_re - part->gain_im * turned_im;
    const double im = part->gain_re * turned_im + part->gain_im * turned_re;
    for (int axis = 0; axis < 2; axis++) {
        active->re[axis] += force_n[axis] * re;
        active->im[axis] += force_n[axis] * im;
        state->ringing_n[axis] += force_n[axis] * im;
    }
}

/* Interpolates from `from` (share 0) to `to` (share 1); exact at share 1. */
HD_RT static double interpolate(double from, double to, double share) {
    return share == 1.0 ? to : from + share * (to - from);
}

/* Gains of a component, real and imaginary part. */
struct gains {
    double free[2];
    double touched[2];
    const double *kept; /* those with which the probe stays in contact; NULL: as `touched` */
};

/* Strikes a component with a gain between the free one and the one in contact. The difference between kept gains and
 * those in contact rings as a separate mode, which needs a preload (hd_preload.h). */
HD_RT static void strike_component(struct hd_state *state, const struct hd_strike *strike, struct component *part,
                                   const struct gains *gains, double share, const double force_n[2], double period_s) {
    const double *kept = gains->kept;
    const double *gain = kept != NULL ? kept : gains->touched;
    part->gain_re = interpolate(gains->free[0], gain[0], share);
    part->gain_im = interpolate(gains->free[1], gain[1], share);
    strike_part(state, strike, part, force_n, period_s);
    if (kept != NULL) {
        part->gain_re = share * (gains->touched[0] - kept[0]);
        part->gain_im = share * (gains->touched[1] - kept[1]);
        part->use += 2u * HD_MODE_USES;
        strike_part(state, strike, part, force_n, period_s);
    }
}

HD_RT static const double *kept_gains(const struct hd_strike *strike, uint32_t index) {
    return strike->second_tail != NULL && strike->lifts && !strike->bare ? strike->kept + index : NULL;
}

HD_RT static void strike_tail(struct hd_state *state, const struct hd_strike *strike, double share,
                              const double force_n[2], double period_s) {
    const struct hd_mode *mode = strike->mode;
    struct component tail = {
        .rotor_re = mode->tail_rotor_re,
        .rotor_im = mode->tail_rotor_im,
        .decay_rate_per_s = mode->tail_decay_rate_per_s,
        .angular_frequency_rad_per_s = mode->tail_angular_frequency_rad_per_s,
        .end_s = mode->tail_end_s,
        .use = HD_MODE_USES + strike->use,
    };
    const struct gains gains = {
        {mode->free_tail_re, mode->free_tail_im},
        {mode->tail_re, mode->tail_im},
        kept_gains(strike, HD_KEPT_TAIL_GAIN),
    };
    strike_component(state, strike, &tail, &gains, share, force_n, period_s);
}

HD_RT static void strike_second_tail(struct hd_state *state, const struct hd_strike *strike, double share,
                                     const double force_n[2], double period_s) {
    const double *numbers = strike->second_tail;
    const double *full = strike->kept + HD_KEPT_FULL_SECOND_TAIL_GAIN;
    struct component tail = {
        .rotor_re = numbers[HD_KEPT_ROTOR],
        .rotor_im = numbers[HD_KEPT_ROTOR + 1],
        .decay_rate_per_s = numbers[HD_KEPT_DECAY_PER_S],
        .angular_frequency_rad_per_s = numbers[HD_KEPT_RAD_PER_S],
        .end_s = numbers[HD_KEPT_END_S],
        .use = HD_MODE_USES + strike->use,
    };
    const struct gains gains = {{0.0, 0.0}, {full[0], full[1]}, kept_gains(strike, HD_KEPT_SECOND_TAIL_GAIN)};
    strike_component(state, strike, &tail, &gains, share, force_n, period_s);
}

HD_RT void hd_modes_strike(struct hd_state *state, const struct hd_strike *strike, const double force_n[2],
                           double period_s) {
    const struct hd_mode *mode = strike->mode;
    const double share = mode->touched_n_per_m > 0.0 && !strike->bare ? strike->touched : 1.0;
    struct component own = {
        .rotor_re = mode->rotor_re,
        .rotor_im = mode->rotor_im,
        .decay_rate_per_s = mode->decay_rate_per_s,
        .angular_frequency_rad_per_s = mode->angular_frequency_rad_per_s,
        .end_s = mode->end_s,
        .use = strike->use,
    };
    const struct gains bare = {{1.0, 0.0}, {1.0, 0.0}, NULL};
    const struct gains gains = {
        {mode->free_gain_re, mode->free_gain_im},
        {mode->gain_re, mode->gain_im},
        kept_gains(strike, HD_KEPT_GAIN),
    };
    strike_component(state, strike, &own, strike->bare ? &bare : &gains, share, force_n, period_s);
    if (strike->bare) {
        return;
    }
    if (mode->tail_end_s > 0.0) {
        strike_tail(state, strike, share, force_n, period_s);
    }
    if (strike->second_tail != NULL) {
        strike_second_tail(state, strike, share, force_n, period_s);
    }
    if (mode->kick_count > 0 && state->active_mode_count > 0) {
        hd_strike_correction_add(state, mode, strike->before_s / period_s, force_n);
    }
}

/* Multiplies the amplitude of the modes of a chain by `factor`. */
HD_RT static void scale_chain(struct hd_state *state, uint32_t link, double factor) {
    for (uint32_t passed = 0; link != 0 && passed < HD_MODES_COMPARED_MAX; passed++) {
        struct hd_active_mode *active = &state->active_modes[link - 1u];
        for (int axis = 0; axis < 2; axis++) {
            state->ringing_n[axis] -= (1.0 - factor) * active->im[axis];
        }
        active->re *= factor;
        active->im *= factor;
        link = state->mode_ends[link - 1u].next;
    }
}

HD_RT void hd_modes_scale_preloaded(struct hd_state *state, uint32_t slot, double factor) {
    scale_chain(state, state->slots[slot].preloaded, factor);
}

HD_RT void hd_modes_silence_tails(struct hd_state *state, uint32_t slot) {
    scale_chain(state, state->slots[slot].preloaded, 0.0);
    scale_chain(state, state->slots[slot].tail[HD_MODE_TAP], 0.0);
    scale_chain(state, state->slots[slot].tail[HD_MODE_SECOND], 0.0);
}

HD_RT void hd_modes_scale(struct hd_state *state, double factor) {
    if (factor * factor <= HD_SMALLEST_SQUARE) {
        hd_modes_silence(state);
        return;
    }
    for (uint32_t i = 0; i < state->active_mode_count; i++) {
        state->active_modes[i].re *= factor;
        state->active_modes[i].im *= factor;
    }
    hd_strike_correction_scale(state, factor);
    hd_waves_scale(state, factor);
    state->ringing_n[0] *= factor;
    state->ringing_n[1] *= factor;
}

HD_RT void hd_modes_silence(struct hd_state *state) {
    while (state->active_mode_count > 0) {
        remove_mode(state, state->active_mode_count - 1);
    }
    state->ended_count = 0;
    state->ringing_n[0] = 0.0;
    state->ringing_n[1] = 0.0;
    state->kick_count = 0;
    state->wave_count = 0;
}
