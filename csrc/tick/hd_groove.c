#include "tick/hd_groove.h"

#include <math.h>

#include "base/hd_vector.h"
#include "tick/hd_contact.h"
#include "tick/hd_surface.h"
#include "tick/hd_tune.h"

#define HD_PI 3.14159265358979323846
/* Grooves as near to each other as this, in spacings, are one. */
#define HD_GROOVE_SAME 1e-6

/* The groove at or below s. Coordinates are bounded and spacings are not below 1e-9 m, so it fits. */
HD_RT static int64_t groove_below(double spacing_m, double arc_m) {
    HD_RT_FOREIGN_BEGIN
    const double quotient = floor(arc_m / spacing_m);
    HD_RT_FOREIGN_END
    const double bounded = quotient < -9e15 ? -9e15 : quotient > 9e15 ? 9e15 : quotient;
    int64_t k = (int64_t)bounded;
    /* The quotient is rounded; the groove lies at the rounded product. */
    if ((double)k * spacing_m > arc_m) {
        k--;
    } else if ((double)(k + 1) * spacing_m <= arc_m) {
        k++;
    }
    return k;
}

/* From one place to the other, the shorter way round a disc. */
HD_RT static double way_between(double a_m, double b_m, double half_length_m) {
    const double way = hd_magnitude(a_m - b_m);
    return way > half_length_m ? 2.0 * half_length_m - way : way;
}

/* Whether groove k has a shape: it lies on the disc whole, or its halves meet at the bottom. */
HD_RT static int is_whole(const struct hd_material *material, int64_t k, double half_length_m) {
    const double middle_m = hd_magnitude((double)k * material->spacing_m);
    return middle_m + 0.5 * material->width_m <= half_length_m ||
           hd_magnitude(middle_m - half_length_m) <= HD_GROOVE_SEAM * half_length_m;
}

HD_RT double hd_groove_profile(const struct hd_material *material, double arc_m, double half_length_m, double *slope) {
    *slope = 0.0;
    const int64_t k = groove_below(material->spacing_m, arc_m + 0.5 * material->spacing_m);
    const double offset = arc_m - (double)k * material->spacing_m;
    if (2.0 * hd_magnitude(offset) >= material->width_m || !is_whole(material, k, half_length_m)) {
        return 0.0;
    }
    const double turn = 2.0 * HD_PI / material->width_m;
    HD_RT_FOREIGN_BEGIN
    *slope = -0.5 * turn * sin(turn * offset);
    return 0.5 + 0.5 * cos(turn * offset);
    HD_RT_FOREIGN_END
}

HD_RT void hd_grooves_arm(struct hd_slot *slot, double arc_m, double half_length_m) {
    if (way_between(arc_m, slot->groove_m, half_length_m) >= slot->groove_free_m) {
        slot->held = 0;
    }
}

HD_RT static void strike(struct hd_context *context, uint32_t index, const struct hd_material *material,
                         const struct hd_stretch *stretch, int64_t k) {
    struct hd_state *state = context->state;
    struct hd_slot *slot = &state->slots[index];
    const double groove_m = (double)k * material->spacing_m;
    /* At the bottom of a disc the first and the last groove may be one. */
    const double apart_m = way_between(groove_m, slot->groove_m, stretch->half_length_m);
    if (slot->held && apart_m <= HD_GROOVE_SAME * material->spacing_m) {
        return;
    }
    slot->groove_m = groove_m;
    slot->groove_free_m = 0.5 * material->spacing_m;
    slot->held = 1;
    slot->grooves++;
    const double part = (groove_m - stretch->from_m) / (stretch->to_m - stretch->from_m);
    const double fraction = stretch->from_fraction + part * (stretch->to_fraction - stretch->from_fraction);
    const double pressed = stretch->from_n + part * (stretch->to_n - stretch->from_n);
    const double force = pressed > 0.0 ? pressed : 0.0;
    const double sign = stretch->to_m > stretch->from_m ? 1.0 : -1.0;
    const double amplitude = material->velocity_gain_per_s * hd_magnitude(stretch->speed_m_per_s) +
                             material->force_gain_m_per_s2_per_n * force;
    struct hd_event *event = hd_event_add_at(state, HD_EVENT_GROOVE, context->input->time_ns, index);
    struct hd_strike struck = {
        .mode = &material->groove,
        .slot = index,
        .generation = slot->generation,
        .use = HD_MODE_GROOVE,
        .event = hd_event_index(state, event),
        .units = amplitude,
        .before_s = hd_before_tick(context, fraction),
        .direction = {sign * stretch->tangent[0], sign * stretch->tangent[1]},
    };
    event->before_tick_s = struck.before_s;
    event->speed_m_per_s = stretch->speed_m_per_s;
    event->true_speed_m_per_s = stretch->true_speed_m_per_s;
    event->amplitude_m_per_s2 = amplitude;
    event->value = (double)slot->grooves;
    if (material->tune_speeds == 0 ||
        hd_tune_strike(context->table, material, stretch->speed_m_per_s, force, &struck)) {
        hd_strike_add(state, &struck);
    }
}

/* The last groove that lies before s, where a point of the way counts as beyond a groove that it lies on, and the place
 * where two materials meet does not: that groove is one of the latter's. */
HD_RT static int64_t last_before(double spacing_m, double arc_m, int meeting) {
    const int64_t k = groove_below(spacing_m, arc_m);
    return meeting && (double)k * spacing_m == arc_m ? k - 1 : k;
}

/* The part of a stretch that lies on one material, from where it begins or a material is met to where it ends or
 * another one is met. */
struct part {
    double from_m;
    double to_m;
    int meets_from;
    int meets_to;
    int64_t room; /* for strikes of this stretch that are still to come */
};

HD_RT static void pass_material(struct hd_context *context, uint32_t index, const struct hd_material *material,
                                const struct hd_stretch *stretch, struct part *part) {
    if (material->texture != HD_TEXTURE_STRIKES) {
        return;
    }
    const int64_t from = last_before(material->spacing_m, part->from_m, part->meets_from);
    const int64_t to = last_before(material->spacing_m, part->to_m, part->meets_to);
    const int64_t step = to > from ? 1 : -1;
    int64_t left = to > from ? to - from : from - to;
    int64_t k = to > from ? from + 1 : from;
    if (left > part->room) {
        k += step * (left - part->room);
        left = part->room;
    }
    part->room -= left;
    for (; left > 0; left--, k += step) {
        if (hd_magnitude((double)k * material->spacing_m) <= (1.0 + HD_GROOVE_SEAM) * stretch->half_length_m) {
            strike(context, index, material, stretch, k);
        }
    }
}

HD_RT static void pass(struct hd_context *context, uint32_t index, const struct hd_object *object,
                       const struct hd_stretch *stretch) {
    const struct hd_table *table = context->table;
    if (stretch->from_m == stretch->to_m) {
        return;
    }
    struct part part = {.from_m = stretch->from_m, .to_m = stretch->to_m, .room = HD_GROOVES_PER_TICK};
    if (object->piece_count == 0) {
        pass_material(context, index, &table->materials[object->material], stretch, &part);
        return;
    }
    const struct hd_piece *pieces = &table->pieces[object->piece_first];
    const uint32_t last = hd_surface_piece(table, object, stretch->to_m);
    uint32_t piece = hd_surface_piece(table, object, stretch->from_m);
    for (;;) {
        const uint32_t next = last > piece ? piece + 1 : last < piece ? piece - 1 : piece;
        part.meets_to = next != piece;
        part.to_m = next > piece ? pieces[next].from_m : next < piece ? pieces[piece].from_m : stretch->to_m;
        pass_material(context, index, &table->materials[pieces[piece].material], stretch, &part);
        if (next == piece) {
            return;
        }
        part.meets_from = 1;
        part.from_m = part.to_m;
        piece = next;
    }
}

HD_RT void hd_grooves_pass(struct hd_context *context, uint32_t index, const struct hd_object *object,
                           const struct hd_stretch *stretch) {
    struct hd_slot *slot = &context->state->slots[index];
    if (slot->held) {
        hd_grooves_arm(slot, stretch->from_m, stretch->half_length_m);
    }
    pass(context, index, object, stretch);
    if (slot->held) {
        hd_grooves_arm(slot, stretch->to_m, stretch->half_length_m);
    }
}
