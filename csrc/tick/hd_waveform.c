/* Waveforms of taps: started, played from tick to tick, bounded and ended. Playing waveforms are dense and unordered.
 * The free ones lie behind them and keep their blocks of samples, so that ending a waveform exchanges two small records
 * and moves no samples. */
#include "tick/hd_waveform.h"

#include <math.h>

#include "base/hd_vector.h"

/* Squares of a force per unit below this, N^2, could become subnormal. */
#define HD_WAVE_SMALLEST_SQUARE 1e-290

/* Returns the position of a waveform on its curve in this tick, in samples. */
HD_RT static double curve_position(const struct hd_wave *wave) {
    return (double)wave->ticks * wave->step + wave->begin;
}

/* Returns the value of the curve. `samples` start with the 0 before the first one; 0 <= place < count - 1. */
HD_RT static double curve_at(const double *samples, double place) {
    const uint32_t k = (uint32_t)place;
    const double x = place - (double)k;
    const double before = samples[k];
    const double from = samples[k + 1u];
    const double to = samples[k + 2u];
    const double after = samples[k + 3u];
    const double cubic = 3.0 * (from - to) + after - before;
    const double square = 2.0 * before - 5.0 * from + 4.0 * to - after;
    return from + 0.5 * x * (to - before + x * (square + x * cubic));
}

HD_RT static void add_sample(struct hd_state *state, const struct hd_wave *wave, double sign) {
    const double value = sign * curve_at(state->wave_blocks[wave->block].samples, curve_position(wave));
    state->ringing_n[0] += value * wave->force_n[0];
    state->ringing_n[1] += value * wave->force_n[1];
}

HD_RT static void remove_wave(struct hd_state *state, uint32_t index) {
    const uint32_t last = --state->wave_count;
    const struct hd_wave gone = state->waves[index];
    state->waves[index] = state->waves[last];
    state->waves[last] = gone;
}

HD_RT void hd_waves_advance(struct hd_state *state, uint32_t periods) {
    uint32_t i = 0;
    while (i < state->wave_count) {
        struct hd_wave *wave = &state->waves[i];
        wave->ticks += periods;
        if (curve_position(wave) < wave->end) {
            add_sample(state, wave, 1.0);
            i++;
        } else {
            remove_wave(state, i);
        }
    }
}

HD_RT double hd_waves_bound(const struct hd_state *state) {
    double bound = 0.0;
    for (uint32_t i = 0; i < state->wave_count; i++) {
        const struct hd_wave *wave = &state->waves[i];
        const uint32_t part = (uint32_t)(curve_position(wave) / wave->end * (double)HD_WAVE_PARTS);
        const double peak = state->wave_blocks[wave->block].peaks[part < HD_WAVE_PARTS ? part : HD_WAVE_PARTS - 1u];
        bound += peak * hd_root(hd_dot(wave->force_n, wave->force_n));
    }
    return bound;
}

/* Ends the waveform that is nearest its end. */
HD_RT static void drop_nearest_end(struct hd_state *state) {
    uint32_t nearest = 0;
    double least = (double)INFINITY;
    for (uint32_t i = 0; i < state->wave_count; i++) {
        const struct hd_wave *wave = &state->waves[i];
        const double remaining = (wave->end - curve_position(wave)) / wave->step; /* ticks */
        if (remaining < least) {
            least = remaining;
            nearest = i;
        }
    }
    add_sample(state, &state->waves[nearest], -1.0);
    remove_wave(state, nearest);
}

HD_RT void hd_waves_strike(struct hd_state *state, const struct hd_table *table, const struct hd_strike *strike,
                           const double force_n[2]) {
    const struct hd_material *material = strike->wave;
    const uint32_t count = material->wave_count;
    const double begin = strike->before_s * material->wave_rate_hz;
    const double end = (double)(count - 1u);
    if (!(begin < end) || !(hd_dot(force_n, force_n) > HD_WAVE_SMALLEST_SQUARE)) {
        return; /* ended before this tick, or too small */
    }
    if (state->wave_count == HD_WAVE_CAPACITY) {
        drop_nearest_end(state);
    }
    struct hd_wave *wave = &state->waves[state->wave_count++];
    wave->force_n[0] = force_n[0];
    wave->force_n[1] = force_n[1];
    wave->step = table->period_s * material->wave_rate_hz;
    wave->begin = begin;
    wave->end = end;
    wave->ticks = 0;
    struct hd_wave_block *block = &state->wave_blocks[wave->block];
    const double *numbers = table->numbers + material->wave_first;
    block->samples[0] = 0.0;
    for (uint32_t i = 0; i < count; i++) {
        block->samples[i + 1u] = numbers[i];
    }
    block->samples[count + 1u] = 0.0;
    for (uint32_t i = 0; i < HD_WAVE_PARTS; i++) {
        block->peaks[i] = numbers[count + i];
    }
    add_sample(state, wave, 1.0);
}

HD_RT void hd_waves_scale(struct hd_state *state, double factor) {
    for (uint32_t i = 0; i < state->wave_count; i++) {
        state->waves[i].force_n[0] *= factor;
        state->waves[i].force_n[1] *= factor;
    }
}
