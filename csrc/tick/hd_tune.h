/* Strikes that have a mode of their own: grooves whose frequency follows tangential speed and normal force, and taps
 * whose frequency and decay follow the approach speed.
 *
 * Of a material with tune_speeds > 0 the table's numbers hold, from tune_first on: speeds [tune_speeds], forces
 * [tune_forces], both rising; angular frequencies [tune_speeds][tune_forces]; nodes [tune_nodes][HD_TUNE_NODE]. Between
 * the points the frequency is bilinear, beyond the outermost it stays. B is that of the groove's mode.
 *
 * A node says what compensation makes of a frequency, in the order of enum hd_tune_number. Nodes are at rising
 * frequencies, and between two of them everything lies on a straight line; all share the poles of one tail. Without
 * nodes nothing is compensated for.
 *
 * Of a material with mode_count > 0 the numbers hold, from mode_first on: speeds [mode_count], rising; angular
 * frequencies [mode_count]; decay times [mode_count], on straight lines between the points and constant beyond; nodes
 * [mode_nodes][HD_TUNE_NODE] over the speed, which is at HD_TUNE_AT instead of the frequency.
 *
 * Each strike has the mode of its own speed and force until it ends: strikes of one mode share an active mode. */
#ifndef HD_TUNE_H
#define HD_TUNE_H

#include "base/hd_rt.h"
#include "tick/hd_state.h"

enum hd_tune_number {
    HD_TUNE_AT = 0, /* rad/s; of a tap m/s */
    HD_TUNE_GAIN = 1,
    HD_TUNE_TAIL = 3,
    HD_TUNE_FREE_GAIN = 5,
    HD_TUNE_FREE_TAIL = 7,
    HD_TUNE_PEAK = 9,
    HD_TUNE_FREE_PEAK = 10
};

/* Gives a strike its frequency. Above the highest that can be displayed it is that one, with the same first peak; 0:
 * such a strike is silent. */
HD_RT int hd_tune_strike(const struct hd_table *table, const struct hd_material *material, double speed_m_per_s,
                         double force_n, struct hd_strike *strike);
/* Gives a tap its mode, and `peak_s`, the time of its first peak. `units` of a first peak become those of the
 * coefficient; the strike's are those that are displayed. 0: it is silent. */
HD_RT int hd_tune_tap(const struct hd_table *table, const struct hd_material *material, double speed_m_per_s,
                      struct hd_strike *strike, double *units, double *peak_s);
/* The mode of a strike that has a mode of its own. */
HD_RT void hd_tune_mode(const struct hd_table *table, const struct hd_strike *strike, struct hd_mode *mode);
/* Control side. */
int hd_tune_check(const struct hd_material *material, const struct hd_table *table, uint32_t index);

#endif
