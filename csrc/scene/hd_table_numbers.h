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
 * of the frequency.
 *
 * For a material with kept_count > 0 the numbers hold, from kept_first on: the second tail of the tap [HD_KEPT_TAIL];
 * gains of the tap [HD_KEPT_GAINS] and of its second mode, in the order of enum hd_kept_number; depths per approach
 * speed [kept_count], m per m/s, at or below which the kept gains sound; depths [kept_count] from which the full gains
 * sound (hd_preload.h). The depth is not judged where the latter are not above the former. The gains of a mode's record
 * are full gains. Without a surface the second tail is silent. */
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

/* Index of the numbers of a second tail, and of the gains of a mode, real and imaginary part. */
enum hd_kept_number {
    HD_KEPT_ROTOR = 0,
    HD_KEPT_DECAY_PER_S = 2,
    HD_KEPT_RAD_PER_S = 3,
    HD_KEPT_END_S = 4,
    HD_KEPT_GAIN = 0,
    HD_KEPT_TAIL_GAIN = 2,
    HD_KEPT_SECOND_TAIL_GAIN = 4,
    HD_KEPT_FULL_SECOND_TAIL_GAIN = 6
};

/* Returns the number of numbers in front of the depths. */
HD_RT static inline size_t hd_kept_depths(void) {
    return HD_KEPT_TAIL + 2u * HD_KEPT_GAINS;
}

/* Returns the number of numbers of a material's compensated taps. */
HD_RT static inline size_t hd_kept_size(uint32_t points) {
    return hd_kept_depths() + 2u * (size_t)points;
}

/* Returns the number of numbers of a node of a noise. */
HD_RT static inline size_t hd_noise_node_size(const struct hd_noise *noise) {
    return 1u + (size_t)noise->order + (noise->taps ? (size_t)noise->order + 1u : 0u);
}

#endif
