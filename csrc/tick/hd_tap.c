/* Taps: amplitude from the approach speed, mode or waveform, and strike. */
#include "tick/hd_tap.h"

#include "tick/hd_aim.h"
#include "tick/hd_preload.h"
#include "tick/hd_strike_mode.h"
#include "tick/hd_surface.h"

HD_RT static double at_least_0(double value) {
    return value > 0.0 ? value : 0.0;
}

HD_RT static const struct hd_material *material_at(const struct hd_context *context, const struct hd_object *object,
                                                   double arc_m) {
    const struct hd_table *table = context->table;
    const uint32_t material =
        object->piece_count == 0 ? object->material
                                 : table->pieces[object->piece_first + hd_surface_piece(table, object, arc_m)].material;
    return &table->materials[material];
}

/* Returns the strength of a tap in the unit of its mode: the approach speed, or the value interpolated from the table
 * of the material. */
HD_RT static double tap_units(const struct hd_table *table, const struct hd_material *material, double approach) {
    const uint32_t count = material->tap_count;
    if (count == 0) {
        return approach;
    }
    const double *speeds = table->numbers + material->tap_first;
    const double *amplitudes = speeds + count;
    /* Finds the first point whose speed is not below the approach speed, or the last one. */
    uint32_t end = 0;
    for (uint32_t last = count - 1u; end < last;) {
        const uint32_t middle = end + (last - end) / 2u;
        if (speeds[middle] < approach) {
            end = middle + 1u;
        } else {
            last = middle;
        }
    }
    const double from = end > 0 ? speeds[end - 1u] : 0.0;
    const double low = end > 0 ? amplitudes[end - 1u] : 0.0;
    return at_least_0(low + (amplitudes[end] - low) * ((approach - from) / (speeds[end] - from)));
}

HD_RT void hd_tap_strike(struct hd_context *context, uint32_t index, const struct hd_object *object,
                         const struct hd_contact_point *point, double before_s, double approach,
                         struct hd_event *event) {
    struct hd_state *state = context->state;
    const struct hd_slot *slot = &state->slots[index];
    const struct hd_material *material = material_at(context, object, point->arc_m);
    double units = tap_units(context->table, material, approach);
    event->amplitude_m_per_s2 = material->tap.amplitude_per_unit * units;
    if (!(units > 0.0)) {
        return; /* a strike of strength 0 would replace a playing effect of the device */
    }
    double peak_time_s = material->tap.peak_time_s;
    const uint32_t struck = state->strike_count;
    uint32_t bounced = 0;
    const double *second_tail = hd_preload_begin(context, index, material, before_s, approach, &bounced);
    struct hd_strike strike = {
        .mode = &material->tap,
        .slot = index,
        .generation = slot->generation,
        .use = HD_MODE_TAP,
        .event = hd_event_index(state, event),
        .units = units,
        .before_s = before_s,
        .wave = material->wave_count > 0 ? material : NULL,
        .bare = bounced,
        .second_tail = second_tail,
        .lifts = 1,
    };
    strike.kept = strike.second_tail != NULL ? strike.second_tail + HD_KEPT_TAIL : NULL;
    const int heard = material->mode_count == 0 ||
                      hd_strike_mode_tap(context->table, material, approach, &strike, &units, &peak_time_s);
    const double peak_s = at_least_0(peak_time_s - before_s);
    strike.growth_n = material->stiffness_n_per_m * approach * peak_s;
    if (heard) {
        hd_aim_strike(state, slot, material->tap_aim, point->normal, &strike);
    }
    if (material->second.force_per_unit > 0.0) {
        /* The force grows until the later of the two peaks and must be counted once. The first strike has counted it up
         * to its peak, unless it is silent. */
        const double counted_s = state->strike_count > struck ? peak_s : 0.0;
        const double longer_s = at_least_0(material->second.peak_time_s - before_s) - counted_s;
        strike.mode = &material->second;
        strike.units = units;
        strike.tuned = NULL;
        strike.use = HD_MODE_SECOND;
        strike.wave = NULL;
        strike.kept = strike.second_tail != NULL ? strike.kept + HD_KEPT_GAINS : NULL;
        strike.lifts = 1;
        strike.growth_n = material->stiffness_n_per_m * approach * at_least_0(longer_s);
        hd_aim_strike(state, slot, material->tap_aim, point->normal, &strike);
    }
}
