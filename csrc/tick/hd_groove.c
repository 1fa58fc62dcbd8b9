/* Grooves that a probe passes in a tick, and the strike of each of them. */
#include "tick/hd_groove.h"

#include "tick/hd_groove_profile.h"
#include "tick/hd_strike.h"
#include "tick/hd_strike_mode.h"
#include "tick/hd_surface.h"

/* Grooves closer than this, in spacings, are the same groove. */
#define HD_GROOVE_SAME 1e-6
/* Largest number of strikes on one stretch of a tick's path along one object. With more strikes per tick, single
 * grooves cannot be felt. */
#define HD_GROOVES_PER_TICK 1024

/* One straight stretch of a tick's path along a surface. */
struct stretch {
    double from_m; /* s */
    double to_m;
    double from_fraction; /* of the tick's path */
    double to_fraction;
    double from_n; /* the model's normal force; a value below 0 counts as 0 */
    double to_n;
    double half_length_m;
    const double *tangent;
    double speed_m_per_s; /* along the tangent */
    double true_speed_m_per_s;
};

/* Returns the distance of two arc lengths, on a disc the shorter way round. */
HD_RT static double distance_between(double a_m, double b_m, double half_length_m) {
    const double distance = hd_magnitude(a_m - b_m);
    return distance > half_length_m ? 2.0 * half_length_m - distance : distance;
}

HD_RT void hd_grooves_arm(struct hd_slot *slot, double arc_m, double half_length_m) {
    if (distance_between(arc_m, slot->groove_m, half_length_m) >= slot->groove_free_m) {
        slot->held = 0;
    }
}

HD_RT static void strike_groove(struct hd_context *context, uint32_t index, const struct hd_material *material,
                                const struct stretch *stretch, int64_t k) {
    struct hd_state *state = context->state;
    struct hd_slot *slot = &state->slots[index];
    const double groove_m = (double)k * material->spacing_m;
    /* Compares distances, since at the bottom of a disc the first and the last groove can coincide. */
    const double apart_m = distance_between(groove_m, slot->groove_m, stretch->half_length_m);
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
        hd_strike_mode_groove(context->table, material, stretch->speed_m_per_s, force, &struck)) {
        hd_strike_add(state, &struck);
    }
}

/* Returns the last groove before s. An end of the path that lies on a groove counts as beyond it. A boundary of two
 * materials (`meeting`) that lies on a groove counts as before it, so that the groove belongs to the material at larger
 * s. */
HD_RT static int64_t groove_before(double spacing_m, double arc_m, int meeting) {
    const int64_t k = hd_groove_below(spacing_m, arc_m);
    return meeting && (double)k * spacing_m == arc_m ? k - 1 : k;
}

/* The section of a stretch that lies on one material. */
struct section {
    double from_m;
    double to_m;
    int meets_from; /* from_m is a boundary of two materials */
    int meets_to;   /* to_m is a boundary of two materials */
    int64_t room;   /* strikes that the stretch may still have */
};

HD_RT static void pass_material(struct hd_context *context, uint32_t index, const struct hd_material *material,
                                const struct stretch *stretch, struct section *part) {
    if (material->texture != HD_TEXTURE_STRIKES) {
        return;
    }
    const int64_t from = groove_before(material->spacing_m, part->from_m, part->meets_from);
    const int64_t to = groove_before(material->spacing_m, part->to_m, part->meets_to);
    const int64_t step = to > from ? 1 : -1;
    int64_t remaining = to > from ? to - from : from - to;
    int64_t k = to > from ? from + 1 : from;
    if (remaining > part->room) {
        k += step * (remaining - part->room);
        remaining = part->room;
    }
    part->room -= remaining;
    for (; remaining > 0; remaining--, k += step) {
        if (hd_magnitude((double)k * material->spacing_m) <= (1.0 + HD_GROOVE_SEAM) * stretch->half_length_m) {
            strike_groove(context, index, material, stretch, k);
        }
    }
}

HD_RT static void pass_stretch(struct hd_context *context, uint32_t index, const struct hd_object *object,
                               const struct stretch *stretch) {
    const struct hd_table *table = context->table;
    if (stretch->from_m == stretch->to_m) {
        return;
    }
    struct section part = {.from_m = stretch->from_m, .to_m = stretch->to_m, .room = HD_GROOVES_PER_TICK};
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

/* Strikes the grooves of a stretch, and updates which groove can be struck again. */
HD_RT static void pass_and_arm(struct hd_context *context, uint32_t index, const struct hd_object *object,
                               const struct stretch *stretch) {
    struct hd_slot *slot = &context->state->slots[index];
    if (slot->held) {
        hd_grooves_arm(slot, stretch->from_m, stretch->half_length_m);
    }
    pass_stretch(context, index, object, stretch);
    if (slot->held) {
        hd_grooves_arm(slot, stretch->to_m, stretch->half_length_m);
    }
}

HD_RT void hd_grooves_pass(struct hd_context *context, uint32_t index, const struct hd_object *object,
                           const struct hd_travel *travel) {
    const struct hd_slot *slot = &context->state->slots[index];
    const struct hd_surface *surface = &slot->surface;
    const struct hd_contact_point *point = &travel->point;
    const double *velocity = context->input->velocity_m_per_s;
    const double half_length_m = travel->half_length_m;
    const double fraction = travel->fraction;
    const double part = travel->part;
    const double damping_n = -surface->damping_n_s_per_m * hd_dot(velocity, point->normal);
    const double from_n = slot->last.depth_m > 0.0 ? slot->normal_n : damping_n;
    const double to_n = surface->stiffness_n_per_m * (point->depth_m - surface->lowering_m) + damping_n;
    const double travel_m = part * (point->arc_m + travel->jump_m - slot->last.arc_m);
    struct stretch stretch = {
        .from_m = slot->last.arc_m,
        .to_m = part < 1.0 ? slot->last.arc_m + travel_m : point->arc_m + travel->jump_m,
        .from_fraction = fraction,
        .to_fraction = fraction + part * (1.0 - fraction),
        .from_n = from_n,
        .to_n = from_n + part * (to_n - from_n),
        .half_length_m = half_length_m,
        .tangent = travel->tangent,
        .speed_m_per_s = hd_dot(velocity, travel->tangent),
        .true_speed_m_per_s = hd_dot(context->input->true_velocity_m_per_s, travel->tangent),
    };
    /* A step across the bottom can be too small to change s there. */
    if (travel->jump_m != 0.0 && hd_magnitude(stretch.to_m) >= half_length_m && stretch.to_m != stretch.from_m) {
        const double bottom = (1.0 + HD_GROOVE_SEAM) * half_length_m;
        const double end = stretch.to_m > 0.0 ? bottom : -bottom;
        const double first_part = (end - stretch.from_m) / (stretch.to_m - stretch.from_m);
        struct stretch first = stretch;
        first.to_m = end;
        first.to_fraction = stretch.from_fraction + first_part * (stretch.to_fraction - stretch.from_fraction);
        first.to_n = stretch.from_n + first_part * (stretch.to_n - stretch.from_n);
        pass_and_arm(context, index, object, &first);
        stretch.from_m = -end;
        stretch.from_fraction = first.to_fraction;
        stretch.from_n = first.to_n;
        stretch.to_m -= stretch.to_m > 0.0 ? 2.0 * half_length_m : -2.0 * half_length_m;
    }
    pass_and_arm(context, index, object, &stretch);
}
