/* Taps that are waveforms: a short curve through samples, scaled by the amplitude and played once for each strike.
 *
 * For a material with wave_count > 0 the table's numbers hold, from wave_first on: samples [wave_count], of which the
 * first and the last are 0; peaks [HD_WAVE_PARTS], where peak i is the largest magnitude of the curve from the
 * beginning of the i-th of HD_WAVE_PARTS equal parts to the end of the curve. Between sample k and sample k + 1, at the
 * fraction x, the curve is the cubic of Catmull and Rom,
 *
 *     s_k + x/2 (s_k+1 - s_k-1 + x (2 s_k-1 - 5 s_k + 4 s_k+1 - s_k+2 + x (3 (s_k - s_k+1) + s_k+2 - s_k-1))),
 *
 * with 0 for samples before the first and after the last. A strike that began tau before a tick has the value of the
 * curve at n T + tau in the n-th tick after it, so onsets between ticks are exact. After the last sample the value is
 * exactly 0.
 *
 * A strike copies its samples into the state: a playing waveform continues unchanged when a scene replaces the
 * material.
 */
#ifndef HD_WAVEFORM_H
#define HD_WAVEFORM_H

#include "base/hd_rt.h"
#include "tick/hd_state.h"

/* Advances all waveforms by `periods` ticks, ends those that are over and adds the others to state->ringing_n. */
HD_RT void hd_waves_advance(struct hd_state *state, uint32_t periods);
/* Returns an upper bound of the sum of all waveforms from now on, N. */
HD_RT double hd_waves_bound(const struct hd_state *state);
/* Starts the waveform of the strike's material with `force_n`, a vector, per unit of the curve. */
HD_RT void hd_waves_strike(struct hd_state *state, const struct hd_table *table, const struct hd_strike *strike,
                           const double force_n[2]);
HD_RT void hd_waves_scale(struct hd_state *state, double factor);

#endif
