/* Layout of the table's numbers that materials and noises refer to (hd_api.h describes the others).
 *
 * For a material with tune_speeds > 0 the table's numbers hold, from tune_first on: speeds [tune_speeds] and forces
 * [tune_forces], both rising; angular frequencies [tune_speeds][tune_forces]; nodes [tune_nodes][HD_TUNE_NODE]. The
 * frequency is interpolated bilinearly between the points and constant beyond them. B is that of the groove's mode.
 *
 * A node holds the compensation at one frequency, in the order of enum hd_tune_number. Nodes are at rising frequencies;
 * between two nodes all values are interpolated linearly. All nodes share the poles of one tail. Without nodes there is
 * no compensation.
 *
 * For a material with mode_count > 0 the numbers hold, from mode_first on: speeds [mode_count], rising; angular
 * frequencies [mode_count]; decay times [mode_count]; nodes [mode_nodes][HD_TUNE_NODE]. Frequencies and decay times are
 * interpolated linearly over the speed and constant beyond the points. These nodes have the speed at HD_TUNE_AT instead
 * of the frequency. */
#ifndef HD_TABLE_NUMBERS_H
#define HD_TABLE_NUMBERS_H

#include "api/hd_core.h"
#include "base/hd_rt.h"

/* Index of the numbers of a node of compensation. */
enum hd_tune_number {
    HD_TUNE_AT = 0, /* rad/s; for a tap m/s */
    HD_TUNE_GAIN = 1,
    HD_TUNE_TAIL = 3,
    HD_TUNE_FREE_GAIN = 5,
    HD_TUNE_FREE_TAIL = 7,
    HD_TUNE_PEAK = 9,
    HD_TUNE_FREE_PEAK = 10
};

/* Returns the number of numbers of a node of a noise. */
HD_RT static inline size_t hd_noise_node_size(const struct hd_noise *noise) {
    return 1u + (size_t)noise->order + (noise->taps ? (size_t)noise->order + 1u : 0u);
}

#endif
