/* Strikes whose mode depends on the motion: grooves whose frequency follows tangential speed and normal force, and taps
 * whose frequency and decay follow the approach speed.
 *
 * scene/hd_table_numbers.h describes their numbers in the table. A strike keeps the mode of its speed and force until
 * it ends; strikes with equal modes share an active mode. */
#ifndef HD_STRIKE_MODE_H
#define HD_STRIKE_MODE_H

#include "base/hd_rt.h"
#include "tick/hd_state.h"

/* Sets the frequency of a groove strike. A frequency above the highest displayable one is lowered to it, with the same
 * first peak. Returns 0 if the material mutes such strikes instead. */
HD_RT int hd_strike_mode_groove(const struct hd_table *table, const struct hd_material *material, double speed_m_per_s,
                                double force_n, struct hd_strike *strike);
/* Sets the mode of a tap and `peak_s`, the time of its first peak. `units`, in and out: if the material gives the first
 * peak, it is converted to the coefficient; strike->units gets the displayed value. Returns 0 if the tap is silent. */
HD_RT int hd_strike_mode_tap(const struct hd_table *table, const struct hd_material *material, double speed_m_per_s,
                             struct hd_strike *strike, double *units, double *peak_s);
/* Computes the mode of a strike that depends on the motion (strike->tuned). */
HD_RT void hd_strike_mode_make(const struct hd_table *table, const struct hd_strike *strike, struct hd_mode *mode);

#endif
