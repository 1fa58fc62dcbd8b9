/* How the table's numbers are laid out, where materials and noises refer to them (hd_api.h says the rest).
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
 * [mode_nodes][HD_TUNE_NODE] over the speed, which is at HD_TUNE_AT instead of the frequency. */
#ifndef HD_TABLE_NUMBERS_H
#define HD_TABLE_NUMBERS_H

#include "api/hd_core.h"
#include "base/hd_rt.h"

/* Of a node of compensation. */
enum hd_tune_number {
    HD_TUNE_AT = 0, /* rad/s; of a tap m/s */
    HD_TUNE_GAIN = 1,
    HD_TUNE_TAIL = 3,
    HD_TUNE_FREE_GAIN = 5,
    HD_TUNE_FREE_TAIL = 7,
    HD_TUNE_PEAK = 9,
    HD_TUNE_FREE_PEAK = 10
};

/* Of a node of a noise. */
HD_RT static inline size_t hd_noise_node_size(const struct hd_noise *noise) {
    return 1u + (size_t)noise->order + (noise->taps ? (size_t)noise->order + 1u : 0u);
}

#endif
