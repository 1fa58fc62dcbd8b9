/* Taps that are waveforms: a short curve through samples, scaled by the amplitude and played once for each strike.
 *
 * Of a material with wave_count > 0 the table's numbers hold, from wave_first on: samples [wave_count], the first and
 * the last 0; peaks [HD_WAVE_PARTS], the largest magnitude of the curve from the beginning of each of so many equal
 * parts to its end. Between sample k and the next, at the share x of the way, the curve is the cubic of Catmull and
 * Rom,
 *
 *     s_k + x/2 (s_k+1 - s_k-1 + x (2 s_k-1 - 5 s_k + 4 s_k+1 - s_k+2 + x (3 (s_k - s_k+1) + s_k+2 - s_k-1))),
 *
 * with 0 for samples before the first and after the last. A strike that began tau before a tick has the value of the
 * curve at n T + tau in the n-th tick after it, so every onset inside a period is exact. After the last sample it is
 * exactly 0.
 *
 * A strike takes its samples along into the state: what plays goes on unchanged when a scene replaces the material. */
#ifndef HD_WAVEFORM_H
#define HD_WAVEFORM_H

#include "base/hd_rt.h"
#include "tick/hd_state.h"

/* All waveforms go on by `periods` ticks, and are added to state->ringing_n; those that ended are no more. */
HD_RT void hd_waves_advance(struct hd_state *state, uint32_t periods);
/* An upper bound of what they can add up to from now on. */
HD_RT double hd_waves_bound(const struct hd_state *state);
/* Begins the waveform of the strike's material with `force_n` (a vector) per unit of the curve. */
HD_RT void hd_waves_strike(struct hd_state *state, const struct hd_table *table, const struct hd_strike *strike,
                           const double force_n[2]);
HD_RT void hd_waves_scale(struct hd_state *state, double factor);

#endif
