/* Strikes that have a mode of their own: grooves whose frequency follows tangential speed and normal force, and taps
 * whose frequency and decay follow the approach speed.
 *
 * Their numbers in the table: scene/hd_table_numbers.h.
 *
 * Each strike has the mode of its own speed and force until it ends: strikes of one mode share an active mode. */
#ifndef HD_STRIKE_MODE_H
#define HD_STRIKE_MODE_H

#include "base/hd_rt.h"
#include "tick/hd_state.h"

/* Gives a strike its frequency. Above the highest that can be displayed it is that one, with the same first peak; 0:
 * such a strike is silent. */
HD_RT int hd_strike_mode_groove(const struct hd_table *table, const struct hd_material *material, double speed_m_per_s,
                                double force_n, struct hd_strike *strike);
/* Gives a tap its mode, and `peak_s`, the time of its first peak. `units` of a first peak become those of the
 * coefficient; the strike's are those that are displayed. 0: it is silent. */
HD_RT int hd_strike_mode_tap(const struct hd_table *table, const struct hd_material *material, double speed_m_per_s,
                             struct hd_strike *strike, double *units, double *peak_s);
/* The mode of a strike that has a mode of its own. */
HD_RT void hd_strike_mode_make(const struct hd_table *table, const struct hd_strike *strike, struct hd_mode *mode);

#endif
