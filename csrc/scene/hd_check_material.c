/* Checks of materials and of their modes. */
#include <stdio.h>

#include "scene/hd_check.h"
#include "scene/hd_table_numbers.h"

/* Checks rotor, decay rate and frequency of a mode or of its tail. */
static int ringing_check(double rotor_re, double rotor_im, double decay_rate_per_s, double angular_frequency_rad_per_s,
                         const char *what, const char *tail) {
    if (!hd_check_between(rotor_re, -1.0, 1.0) || !hd_check_between(rotor_im, -1.0, 1.0) ||
        rotor_re * rotor_re + rotor_im * rotor_im > 1.0 + 1e-12) {
        return hd_invalid("%s: %srotor (%g, %g) is not within the unit circle", what, tail, rotor_re, rotor_im);
    }
    if (!hd_check_between(decay_rate_per_s, 0.0, HD_LARGEST) ||
        !hd_check_between(angular_frequency_rad_per_s, 0.0, HD_LARGEST)) {
        return hd_invalid("%s: %sdecay rate %g and angular frequency %g must lie between 0 and %g", what, tail,
                          decay_rate_per_s, angular_frequency_rad_per_s, HD_LARGEST);
    }
    return HD_OK;
}

int hd_mode_check(const struct hd_mode *mode, const char *what) {
    if (mode->force_per_unit == 0.0 && mode->end_s == 0.0 && mode->effect == 0) {
        return HD_OK; /* there is no mode */
    }
    if (ringing_check(mode->rotor_re, mode->rotor_im, mode->decay_rate_per_s, mode->angular_frequency_rad_per_s, what,
                      "") < 0 ||
        ringing_check(mode->tail_rotor_re, mode->tail_rotor_im, mode->tail_decay_rate_per_s,
                      mode->tail_angular_frequency_rad_per_s, what, "tail's ") < 0) {
        return HD_ERR_INVALID;
    }
    if (!hd_check_bounded(mode->gain_re) || !hd_check_bounded(mode->gain_im) || !hd_check_bounded(mode->tail_re) ||
        !hd_check_bounded(mode->tail_im) || !hd_check_between(mode->tail_end_s, 0.0, HD_LARGEST)) {
        return hd_invalid("%s: gain (%g, %g), tail (%g, %g) or its end at %g s is out of range", what, mode->gain_re,
                          mode->gain_im, mode->tail_re, mode->tail_im, mode->tail_end_s);
    }
    if (!hd_check_between(mode->end_s, 0.0, HD_LARGEST) || !hd_check_between(mode->peak_time_s, 0.0, HD_LARGEST) ||
        !hd_check_between(mode->peak, 0.0, HD_LARGEST)) {
        return hd_invalid("%s: end %g s, peak %g or its time %g s is out of range", what, mode->end_s, mode->peak,
                          mode->peak_time_s);
    }
    if (!hd_check_between(mode->force_per_unit, 0.0, HD_LARGEST) ||
        !hd_check_between(mode->amplitude_per_unit, 0.0, HD_LARGEST)) {
        return hd_invalid("%s: force per unit %g and amplitude per unit %g must lie between 0 and %g", what,
                          mode->force_per_unit, mode->amplitude_per_unit, HD_LARGEST);
    }
    if (!hd_check_between(mode->effect_force_per_unit, 0.0, HD_LARGEST) ||
        !hd_check_between(mode->effect_peak, 0.0, HD_LARGEST) || !hd_check_between(mode->effect_s, 0.0, 1.0)) {
        return hd_invalid("%s: effect force per unit %g, peak %g or duration %g s is out of range", what,
                          mode->effect_force_per_unit, mode->effect_peak, mode->effect_s);
    }
    return HD_OK;
}

int hd_play_check(const struct hd_mode *mode, const double direction[2], double amplitude) {
    const double square = direction[0] * direction[0] + direction[1] * direction[1];
    if (!(square > 1.0 - 1e-9 && square < 1.0 + 1e-9) || !(amplitude >= 0.0 && amplitude <= 1e9)) {
        return hd_invalid("play: direction (%g, %g) must be a unit vector, amplitude %g between 0 and 1e9",
                          direction[0], direction[1], amplitude);
    }
    return hd_mode_check(mode, "play");
}

/* Checks a mode of a material. The name for the reason is composed only if the check fails. */
static int material_mode_check(const struct hd_mode *mode, const char *use, uint32_t index) {
    if (hd_mode_check(mode, use) == HD_OK) {
        return HD_OK;
    }
    char what[48];
    snprintf(what, sizeof what, "material %u: %s", index, use);
    return hd_mode_check(mode, what);
}

static int texture_check(const struct hd_material *material, uint32_t noise_count, uint32_t index) {
    switch (material->texture) {
    case HD_TEXTURE_NONE:
        return HD_OK;
    case HD_TEXTURE_STRIKES:
    case HD_TEXTURE_GEOMETRY:
    case HD_TEXTURE_DRAG:
        if (!hd_check_between(material->width_m, HD_SMALLEST, material->spacing_m)) {
            return hd_invalid("material %u: width of grooves %g m must be between %g m and their spacing, %g m", index,
                              material->width_m, HD_SMALLEST, material->spacing_m);
        }
        return HD_OK;
    case HD_TEXTURE_NOISE:
        return material->noise < noise_count ? HD_OK
                                             : hd_invalid("material %u: noise %u does not exist; there are %u", index,
                                                          material->noise, noise_count);
    default:
        return hd_invalid("material %u: unknown texture %u", index, material->texture);
    }
}

static int tap_check(const struct hd_material *material, const struct hd_table *table, uint32_t index) {
    const uint32_t count = material->tap_count;
    if (count == 0) {
        return HD_OK;
    }
    if (count > HD_TAP_POINTS) {
        return hd_invalid("material %u: the tap has %u points; there must be at most %u", index, count, HD_TAP_POINTS);
    }
    if (material->tap_first > table->number_count || 2u * count > table->number_count - material->tap_first) {
        return hd_invalid("material %u: %u points of its tap, from number %u on, do not fit into %u", index, count,
                          material->tap_first, table->number_count);
    }
    const double *speeds = table->numbers + material->tap_first;
    for (uint32_t i = 0; i < count; i++) {
        const double before = i > 0 ? speeds[i - 1u] : 0.0;
        if (!hd_check_between(speeds[i], before + HD_SMALLEST, HD_LARGEST) ||
            !hd_check_between(speeds[count + i], 0.0, HD_LARGEST)) {
            return hd_invalid(
                "material %u: point %u of its tap, %g m/s^2 at %g m/s, is out of range or not faster than the "
                "point before, %g m/s",
                index, i, speeds[count + i], speeds[i], before);
        }
    }
    return HD_OK;
}

static int is_valid_aim(const double aim[2]) {
    const double square = aim[0] * aim[0] + aim[1] * aim[1];
    return (aim[0] == 0.0 && aim[1] == 0.0) || hd_check_between(square, 1.0 - 1e-6, 1.0 + 1e-6);
}

static int values_check(const struct hd_material *material, uint32_t noise_count, uint32_t index) {
    const struct {
        const char *name;
        double value;
    } amounts[] = {
        {"stiffness", material->stiffness_n_per_m},
        {"damping", material->damping_n_s_per_m},
        {"rupture depth", material->rupture_depth_m},
        {"friction coefficient", material->friction_coefficient},
        {"friction stiffness", material->friction_stiffness_n_per_m},
        {"groove spacing", material->spacing_m},
        {"groove width", material->width_m},
        {"groove depth", material->depth_m},
        {"drag", material->drag_n_s_per_m},
        {"velocity gain", material->velocity_gain_per_s},
        {"force gain", material->force_gain_m_per_s2_per_n},
    };
    for (size_t i = 0; i < sizeof amounts / sizeof amounts[0]; i++) {
        if (!hd_check_between(amounts[i].value, 0.0, HD_LARGEST)) {
            return hd_invalid("material %u: %s %g must lie between 0 and %g", index, amounts[i].name, amounts[i].value,
                              HD_LARGEST);
        }
    }
    if (material->heals > 1) {
        return hd_invalid("material %u: heals must be 0 or 1", index);
    }
    if (!is_valid_aim(material->tap_aim) || !is_valid_aim(material->rupture_aim)) {
        return hd_invalid("material %u: the aim of a tap or a rupture must be a unit vector or (0, 0)", index);
    }
    if (material->friction_coefficient > 0.0 && !(material->friction_stiffness_n_per_m > 0.0)) {
        return hd_invalid("material %u: friction needs a stiffness above 0", index);
    }
    if (texture_check(material, noise_count, index) < 0 || material_mode_check(&material->tap, "tap", index) < 0 ||
        material_mode_check(&material->second, "second mode", index) < 0 ||
        material_mode_check(&material->rupture, "rupture", index) < 0 ||
        material_mode_check(&material->groove, "groove", index) < 0) {
        return HD_ERR_INVALID;
    }
    return HD_OK;
}

static int is_rising(const double *points, uint32_t count, uint32_t stride, double least) {
    for (uint32_t i = 0; i < count; i++) {
        const double before = i > 0 ? points[(i - 1u) * stride] + HD_SMALLEST : least;
        if (!(points[i * stride] >= before && points[i * stride] <= HD_LARGEST)) {
            return 0;
        }
    }
    return 1;
}

static int is_within(const double *numbers, size_t count, double least) {
    for (size_t i = 0; i < count; i++) {
        if (!(numbers[i] >= least && numbers[i] <= HD_LARGEST)) {
            return 0;
        }
    }
    return 1;
}

static int is_valid_highest(const struct hd_material *material) {
    return material->tune_highest_rad_per_s >= HD_SMALLEST && material->tune_highest_rad_per_s <= HD_LARGEST &&
           material->tune_mutes <= 1;
}

static int tap_mode_check(const struct hd_material *material, const struct hd_table *table, uint32_t index) {
    const uint32_t points = material->mode_count;
    const uint32_t nodes = material->mode_nodes;
    if (points == 0) {
        return HD_OK;
    }
    if (points > HD_TUNE_POINTS || nodes > HD_TUNE_NODES || material->wave_count > 0 || material->mode_by_peak > 1) {
        return hd_invalid(
            "material %u: the mode of a tap has %u speeds and %u nodes; it must have 1 to %u, at most %u, "
            "no waveform, and mode_by_peak 0 or 1",
            index, points, nodes, HD_TUNE_POINTS, HD_TUNE_NODES);
    }
    const uint32_t count = 3 * points + nodes * HD_TUNE_NODE;
    if (material->mode_first > table->number_count || count > table->number_count - material->mode_first) {
        return hd_invalid("material %u: %u numbers of the modes of its tap, from number %u on, do not fit into %u",
                          index, count, material->mode_first, table->number_count);
    }
    const double *numbers = table->numbers + material->mode_first;
    const double *node = numbers + 3 * points;
    int sound = is_rising(numbers, points, 1, 0.0) && is_within(numbers + points, 2 * (size_t)points, HD_SMALLEST) &&
                is_rising(node, nodes, HD_TUNE_NODE, 0.0) && is_within(node, (size_t)nodes * HD_TUNE_NODE, -HD_LARGEST);
    for (uint32_t i = 0; i < nodes; i++) {
        sound = sound && is_within(node + (size_t)i * HD_TUNE_NODE + HD_TUNE_PEAK, 2, 0.0);
    }
    if (!sound || !is_valid_highest(material)) {
        return hd_invalid("material %u: speeds, modes or nodes of its tap do not rise or are out of range", index);
    }
    return HD_OK;
}

static int groove_frequencies_check(const struct hd_material *material, const struct hd_table *table, uint32_t index) {
    const uint32_t speeds = material->tune_speeds;
    const uint32_t forces = material->tune_forces;
    const uint32_t nodes = material->tune_nodes;
    if (speeds == 0) {
        return HD_OK;
    }
    if (speeds > HD_TUNE_POINTS || forces == 0 || forces > HD_TUNE_POINTS || nodes > HD_TUNE_NODES) {
        return hd_invalid("material %u: groove frequencies have %u speeds, %u forces and %u nodes; they must have "
                          "1 to %u speeds and forces and at most %u nodes",
                          index, speeds, forces, nodes, HD_TUNE_POINTS, HD_TUNE_NODES);
    }
    const uint32_t grid = speeds * forces;
    const uint32_t count = speeds + forces + grid + nodes * HD_TUNE_NODE;
    if (material->tune_first > table->number_count || count > table->number_count - material->tune_first) {
        return hd_invalid("material %u: %u numbers of groove frequencies, from number %u on, do not fit into %u", index,
                          count, material->tune_first, table->number_count);
    }
    const double *numbers = table->numbers + material->tune_first;
    const double *node = numbers + speeds + forces + grid;
    if (!is_rising(numbers, speeds, 1, 0.0) || !is_rising(numbers + speeds, forces, 1, 0.0) ||
        !is_within(numbers + speeds + forces, grid, HD_SMALLEST) ||
        !is_rising(node, nodes, HD_TUNE_NODE, HD_SMALLEST) ||
        !is_within(node, (size_t)nodes * HD_TUNE_NODE, -HD_LARGEST)) {
        return hd_invalid(
            "material %u: speeds, forces or nodes of its groove frequencies do not rise or are out of range", index);
    }
    for (uint32_t i = 0; i < nodes; i++) {
        if (!is_within(node + (size_t)i * HD_TUNE_NODE + HD_TUNE_PEAK, 2, 0.0)) {
            return hd_invalid("material %u: node %u of its groove frequencies has a peak below 0", index, i);
        }
    }
    if (!is_valid_highest(material) || !(material->groove.decay_rate_per_s > 0.0)) {
        return hd_invalid(
            "material %u: highest groove frequency %g rad/s, tune_mutes %u or decay rate %g 1/s is out of "
            "range",
            index, material->tune_highest_rad_per_s, material->tune_mutes, material->groove.decay_rate_per_s);
    }
    return HD_OK;
}

static int tune_check(const struct hd_material *material, const struct hd_table *table, uint32_t index) {
    const int status = groove_frequencies_check(material, table, index);
    return status < 0 ? status : tap_mode_check(material, table, index);
}

static int wave_check(const struct hd_material *material, const struct hd_table *table, uint32_t index) {
    const uint32_t count = material->wave_count;
    if (count == 0) {
        return HD_OK;
    }
    if (count < 3 || count > HD_WAVE_SAMPLES) {
        return hd_invalid("material %u: its waveform has %u samples; it must have 3 to %u", index, count,
                          HD_WAVE_SAMPLES);
    }
    const uint32_t needed = count + HD_WAVE_PARTS;
    if (material->wave_first > table->number_count || needed > table->number_count - material->wave_first) {
        return hd_invalid("material %u: %u numbers of its waveform, from number %u on, do not fit into %u", index,
                          needed, material->wave_first, table->number_count);
    }
    if (!(material->wave_rate_hz >= 1e-3 && material->wave_rate_hz <= HD_LARGEST)) {
        return hd_invalid("material %u: rate %g Hz of its waveform is out of range", index, material->wave_rate_hz);
    }
    const double *numbers = table->numbers + material->wave_first;
    for (uint32_t i = 0; i < needed; i++) {
        const double least = i < count ? -HD_LARGEST : 0.0;
        if (!(numbers[i] >= least && numbers[i] <= HD_LARGEST)) {
            return hd_invalid("material %u: number %u of its waveform, %g, is out of range", index, i, numbers[i]);
        }
    }
    if (numbers[0] != 0.0 || numbers[count - 1u] != 0.0) {
        return hd_invalid("material %u: its waveform must begin and end with 0, but has %g and %g", index, numbers[0],
                          numbers[count - 1u]);
    }
    return HD_OK;
}

static int kept_check(const struct hd_material *material, const struct hd_table *table, uint32_t index) {
    const uint32_t points = material->kept_count;
    if (points == 0) {
        return HD_OK;
    }
    if (points < 2 || points > HD_KEPT_POINTS || !hd_check_between(material->kept_step_s, HD_SMALLEST, HD_LARGEST)) {
        return hd_invalid("material %u: depths of its tap are judged at %u times, %g s apart; there must be 2 to %u, "
                          "and the distance above 0",
                          index, points, material->kept_step_s, HD_KEPT_POINTS);
    }
    const size_t count = hd_kept_size(points);
    if (material->kept_first > table->number_count || count > table->number_count - material->kept_first) {
        return hd_invalid("material %u: %zu numbers of its compensated tap, from number %u on, do not fit into "
                          "%u",
                          index, count, material->kept_first, table->number_count);
    }
    const double *tail = table->numbers + material->kept_first;
    const int sound = is_within(tail, count, -HD_LARGEST) && is_within(tail + HD_KEPT_DECAY_PER_S, 3, 0.0) &&
                      tail[0] * tail[0] + tail[1] * tail[1] <= 1.0 + 1e-12;
    if (!sound) {
        return hd_invalid("material %u: second tail, gains or depths of its compensated tap are out of range", index);
    }
    return HD_OK;
}

int hd_material_check(const struct hd_material *material, const struct hd_table *table, uint32_t index) {
    if (values_check(material, table->noise_count, index) < 0 || tap_check(material, table, index) < 0 ||
        tune_check(material, table, index) < 0 || kept_check(material, table, index) < 0) {
        return HD_ERR_INVALID;
    }
    return wave_check(material, table, index);
}
