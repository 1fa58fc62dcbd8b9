/* The tick of a surface that is touched: where, of what, and with which force.
 *
 * F = F_n n + F_t t, with e = d - H(s) the depth below the surface as geometry has it,
 *     F_n = max(0, K e + D v_n) while e > 0, else 0
 *     F_t = K e H' - K'/2 e^2 (while e > 0) + friction - drag v_t,
 * v_n = -v.n, v_t = v.t; see hd_surface.h for K, H and their slopes, hd_friction.h for friction. Vibration (grooves,
 * noise) is added to that and never gated by it.
 *
 * On a disc of radius R the probe at r goes r/R of the way that s goes, so there the first three terms of F_t are R/r
 * as large. Deep in it geometry and friction fade with g(r), from 1 to 0 (hd_disc_lever). What is stored is
 *     U = K/2 (d - g H)^2 + g k/2 (s - anchor)^2
 * and the force is its slope, so that n has g' (K e H - k/2 (s - anchor)^2) besides F_n. */
#include <math.h>

#include "tick/hd_aim.h"
#include "tick/hd_contact.h"
#include "tick/hd_friction.h"
#include "tick/hd_groove.h"
#include "tick/hd_seam.h"
#include "tick/hd_surface.h"

#define HD_PI 3.14159265358979323846
#define HD_UNBOUNDED 1e300

/* Of a disc: whether anything depends on s. */
HD_RT static int needs_along(const struct hd_table *table, const struct hd_object *object) {
    const struct hd_material *material = &table->materials[object->material];
    return material->friction_coefficient > 0.0 || material->texture != HD_TEXTURE_NONE;
}

/* `met`: in this tick. */
HD_RT static void find_place(const struct hd_context *context, const struct hd_slot *slot,
                             const struct hd_object *object, int met, struct hd_contact_point *point) {
    const double *position = context->input->position_m;
    switch (object->shape) {
    case HD_SHAPE_WALL:
        hd_wall_place(object, position, point);
        break;
    case HD_SHAPE_MEMBRANE:
        hd_membrane_place(object, slot->side, position, point);
        break;
    case HD_SHAPE_BOX:
        hd_box_place(object, slot->face, position, point);
        break;
    default: {
        double way[2];
        hd_difference(position, context->from_m, way);
        hd_disc_place(object, slot->last.normal, met ? HD_DISC_MOVED : hd_root(hd_dot(way, way)),
                      needs_along(context->table, object), position, point);
        break;
    }
    }
}

/* Where the probe was at the last sample, on the object as it is now; s with it, which of a disc may not be known. */
HD_RT static void find_last(const struct hd_context *context, const struct hd_slot *slot,
                            const struct hd_object *object, int moved, struct hd_contact_point *point) {
    switch (object->shape) {
    case HD_SHAPE_WALL:
        hd_wall_place(object, context->from_m, point);
        break;
    case HD_SHAPE_MEMBRANE:
        hd_membrane_place(object, slot->side, context->from_m, point);
        break;
    case HD_SHAPE_BOX:
        hd_box_place(object, slot->face, context->from_m, point);
        break;
    default:
        hd_disc_place(object, slot->last.normal, moved ? HD_DISC_MOVED : 0.0, 1, context->from_m, point);
        break;
    }
}

/* The force of a surface at a place: along the normal, and along the tangent. `lever`: NULL on what is flat. Moves the
 * anchor. Returns F_n. */
HD_RT static inline double press(const struct hd_surface *surface, const struct hd_contact_point *point,
                                 const double velocity[2], const double tangent[2], const struct hd_lever *lever,
                                 double *anchor_m, double force_n[2]) {
    const double depth = point->depth_m - surface->lowering_m;
    double normal_n = 0.0;
    double elastic = 0.0;
    double slope_n = 0.0;
    if (depth > 0.0) {
        elastic = surface->stiffness_n_per_m * depth;
        const double whole = elastic - surface->damping_n_s_per_m * hd_dot(velocity, point->normal);
        normal_n = whole > 0.0 ? whole : 0.0;
        slope_n = elastic * surface->lowering_slope - 0.5 * surface->stiffness_slope * depth * depth;
    }
    const double drag_n = -surface->drag_n_s_per_m * hd_dot(velocity, tangent);
    double spring_n = hd_friction(surface, normal_n, point->arc_m, anchor_m);
    force_n[0] = normal_n;
    if (lever != NULL) {
        if (lever->fade_per_m > 0.0) {
            const double stored = 0.5 * spring_n * (point->arc_m - *anchor_m); /* below 0 */
            force_n[0] += lever->fade_per_m * (elastic * surface->lowering_m / lever->fade + stored);
        }
        slope_n *= lever->slide;
        spring_n *= lever->slide * lever->fade;
    }
    force_n[1] = drag_n + slope_n + spring_n;
    return normal_n;
}

/* What the surface as it was would press with where the probe is now: the force of the last tick, and what the way
 * since then makes of it on the plane that it was there. */
HD_RT static void press_as_it_was(const struct hd_context *context, const struct hd_slot *slot, double force_n[2]) {
    force_n[0] = slot->force_n[0];
    force_n[1] = slot->force_n[1];
    double way[2];
    hd_difference(context->input->position_m, context->from_m, way);
    if (way[0] == 0.0 && way[1] == 0.0) {
        return;
    }
    struct hd_contact_point point = slot->last;
    struct hd_surface surface = slot->surface;
    double tangent[2];
    double before[2];
    double after[2];
    double anchor_m = slot->anchor_m;
    hd_tangent_of(slot, point.normal, tangent);
    press(&surface, &point, context->input->velocity_m_per_s, tangent, NULL, &anchor_m, before);
    const double slid_m = hd_dot(way, tangent);
    point.depth_m -= hd_dot(way, point.normal);
    point.arc_m += slid_m;
    surface.stiffness_n_per_m += slid_m * surface.stiffness_slope;
    surface.lowering_m += slid_m * surface.lowering_slope;
    press(&surface, &point, context->input->velocity_m_per_s, tangent, NULL, &anchor_m, after);
    for (int axis = 0; axis < 2; axis++) {
        const double more = (after[0] - before[0]) * point.normal[axis] + (after[1] - before[1]) * tangent[axis];
        force_n[axis] += slot->ramp * more;
    }
}

HD_RT void hd_contact_force_drop(struct hd_context *context, uint32_t index) {
    double was[2];
    press_as_it_was(context, &context->state->slots[index], was);
    hd_contact_change(context->state, was);
    context->state->change.whole = 1;
    hd_contact_hush(context->state, &context->state->slots[index]);
    hd_contact_end(context->state, index, context->input->time_ns);
}

HD_RT void hd_contact_force_change(struct hd_context *context, uint32_t index, const struct hd_object *object) {
    struct hd_state *state = context->state;
    struct hd_slot *slot = &state->slots[index];
    struct hd_contact_point point = slot->last;
    const int disc = object->shape == HD_SHAPE_DISC;
    const int moved = slot->pose_version != object->pose_version;
    if (moved || disc) { /* of a disc, s may not be known */
        find_last(context, slot, object, moved, &point);
    }
    if (moved && hd_dot(slot->last.normal, point.normal) <= 0.0) {
        hd_contact_force_drop(context, index); /* it turned its back: it went, and another came */
        return;
    }
    double was[2];
    press_as_it_was(context, slot, was);
    hd_contact_change(state, was);
    slot->changed = 1;
    slot->pose_version = object->pose_version;
    slot->surface_version = object->surface_version;
    slot->last = point;
    if (!(slot->surface.friction_coefficient > 0.0)) {
        slot->anchor_m = point.arc_m;
    } else if (disc) {
        const double round_m = 2.0 * HD_PI * object->half_m[0];
        const double stretch = point.arc_m - slot->anchor_m;
        HD_RT_FOREIGN_BEGIN
        slot->anchor_m += round_m * rint(stretch / round_m); /* s goes round */
        HD_RT_FOREIGN_END
    }
}

/* How much of the way since the last tick the probe goes before it leaves over the edge of a face; 1: all of it. */
HD_RT static double until_edge(const struct hd_slot *slot, const struct hd_contact_point *point, double half) {
    if (hd_magnitude(point->arc_m) <= half) {
        return 1.0;
    }
    const double edge = point->arc_m > 0.0 ? half : -half;
    const double travel = point->arc_m - slot->last.arc_m;
    const double part = travel != 0.0 ? (edge - slot->last.arc_m) / travel : 0.0;
    return part < 0.0 ? 0.0 : part > 1.0 ? 1.0 : part;
}

/* Past the rupture depth, or over the edge before that? 1: it is punctured. */
HD_RT static int ruptures(struct hd_context *context, uint32_t index, const struct hd_object *object,
                          const struct hd_contact_point *point, double fraction) {
    struct hd_state *state = context->state;
    struct hd_slot *slot = &state->slots[index];
    const struct hd_material *material = &context->table->materials[object->material];
    const double limit = material->rupture_depth_m;
    if (!(limit > 0.0)) {
        return 0;
    }
    const double leaves = until_edge(slot, point, object->half_m[0]);
    const double from = slot->last.depth_m;
    const double deepest = from + leaves * (point->depth_m - from);
    if (!(deepest > limit)) {
        return 0;
    }
    /* One that is beyond it by a command ruptures at the end of the tick, so that nothing is heard of it before. */
    const double part = from < limit ? (limit - from) / (point->depth_m - from) : slot->changed ? 1.0 : 0.0;
    const double *normal = point->normal;
    struct hd_event *event = hd_event_add_at(state, HD_EVENT_PUNCTURE, context->input->time_ns, index);
    struct hd_strike strike = {
        .mode = &material->rupture,
        .slot = index,
        .generation = slot->generation,
        .use = HD_MODE_RUPTURE,
        .event = hd_event_index(state, event),
        .units = 1.0,
        .before_s = hd_before_tick(context, fraction + (1.0 - fraction) * part),
        .bare = slot->changed,
    };
    event->before_tick_s = strike.before_s;
    event->speed_m_per_s = -hd_dot(context->input->velocity_m_per_s, normal);
    event->true_speed_m_per_s = -hd_dot(context->input->true_velocity_m_per_s, normal);
    event->amplitude_m_per_s2 = material->rupture.amplitude_per_unit;
    event->value = limit;
    hd_aim_strike(state, slot, material->rupture_aim, normal, &strike);
    if (slot->changed) {
        hd_contact_hush(state, slot);
        slot->changed = 0;
    }
    slot->last = *point; /* its normal says where the probe came from */
    slot->open = state->epoch;
    if (material->heals) {
        state->healing[state->healing_count++] = index;
        slot->healing_index = state->healing_count;
    }
    hd_contact_end(state, index, context->input->time_ns);
    return 1;
}

HD_RT static int left(const struct hd_context *context, uint32_t index, const struct hd_object *object,
                      const double position_m[2], const struct hd_contact_point *point) {
    switch (object->shape) {
    case HD_SHAPE_WALL:
        return !(point->depth_m > 0.0);
    case HD_SHAPE_MEMBRANE:
        return hd_membrane_left(context, object, index, position_m, point);
    case HD_SHAPE_BOX:
        return hd_box_left(context, object, index, context->state->slots[index].face, position_m, point);
    default:
        return hd_disc_left(context, object, index, position_m, point);
    }
}

/* What a noise is to sound like in a tick. */
struct heard {
    const struct hd_noise *noise;
    const double *numbers;
    double scale_n;
    double normal_n;
    double speed_m_per_s;
};

HD_RT static double hear(struct hd_active_noise *active, const struct heard *heard, int changed, double ramp_step) {
    const double scale_n = hd_ease(&active->scale_n, heard->scale_n, changed, ramp_step);
    const double normal_n = hd_ease(&active->normal_n, heard->normal_n, changed, ramp_step);
    return scale_n * hd_noise_next(active, heard->noise, heard->numbers, heard->speed_m_per_s, normal_n, ramp_step);
}

/* `changed`: by a command, so that what is not as it was comes over the ramp. */
HD_RT static void sound(struct hd_context *context, uint32_t index, const struct hd_dominant_material *dominant,
                        const double normal[2], const double tangent[2], double speed_m_per_s, int changed) {
    struct hd_state *state = context->state;
    struct hd_slot *slot = &state->slots[index];
    const struct hd_table *table = context->table;
    const struct hd_noise *noise = &table->noises[dominant->material->noise];
    if (slot->noise == 0) {
        if (state->free_noise_count == 0) {
            return;
        }
        slot->noise = state->free_noises[--state->free_noise_count] + 1u;
        struct hd_active_noise *fresh = &state->noises[slot->noise - 1u];
        /* A noise that begins again within a contact (on another patch, say) is not the same one again. */
        hd_noise_start(fresh, noise, table->numbers, slot->contacts++ + index * 2654435761u);
        fresh->version = noise->version;
    }
    struct hd_active_noise *active = &state->noises[slot->noise - 1u];
    struct hd_active_noise still;
    if (changed) {
        still = *active;
    }
    if (active->version != noise->version) {
        hd_noise_turn(active);
        active->version = noise->version;
    }
    const double *direction = noise->along_normal ? normal : tangent;
    const struct heard heard = {noise, table->numbers, dominant->noise_weight * noise->force_per_unit, slot->normal_n,
                                speed_m_per_s};
    double as_it_was = 0.0;
    const double *along = direction;
    const int eases = changed || active->blend < 1.0 || active->scale_n.off != 0.0 || active->normal_n.off != 0.0;
    if (changed) {
        as_it_was = hd_noise_last(&still);
        along = still.direction;
    } else if (eases) {
        still = *active;
        as_it_was = hear(&still, &heard, 0, 0.0);
    }
    const double sample = hear(active, &heard, changed, context->ramp_step);
    context->noise_rms_n += hd_noise_rms(active);
    if (eases) {
        state->change.noise_rms_n += hd_noise_rms(&still) - hd_noise_rms(active);
    }
    for (int axis = 0; axis < 2; axis++) {
        context->noise_n[axis] += sample * direction[axis];
        if (eases) {
            state->change.eased_n[axis] += sample * direction[axis] - as_it_was * along[axis];
        }
        active->direction[axis] = direction[axis];
    }
    state->change.eases |= eases != 0;
}

/* How much of the way since the last tick the probe was in contact, when at its end it has left. */
HD_RT static double until_left(const struct hd_slot *slot, const struct hd_object *object,
                               const struct hd_contact_point *point) {
    double part = 1.0;
    if (!(point->depth_m > 0.0)) {
        const double rise = slot->last.depth_m - point->depth_m;
        /* A surface that was moved away was not pressed at all. */
        part = slot->last.depth_m > 0.0 && rise > 0.0 ? slot->last.depth_m / rise : 0.0;
    }
    if (object->shape == HD_SHAPE_MEMBRANE || object->shape == HD_SHAPE_BOX) {
        const int side = object->shape == HD_SHAPE_BOX && slot->face % 2 != 0;
        const double edge = until_edge(slot, point, object->half_m[side]);
        part = edge < part ? edge : part;
    }
    return part;
}

HD_RT static int has_strikes(const struct hd_table *table, const struct hd_object *object) {
    return object->piece_count > 0 || table->materials[object->material].texture == HD_TEXTURE_STRIKES;
}

/* Vibration of grooves: the way since the last tick, or since the onset at `fraction` of it, as far as `part` of it. It
 * is one stretch, or on a disc, over its bottom where s jumps, two. The normal force goes in a straight line from what
 * it was to what stiffness and damping give at the end of the way. */
HD_RT static void pass_grooves(struct hd_context *context, uint32_t index, const struct hd_object *object,
                               const struct hd_contact_point *point, const struct hd_surface *surface,
                               const double tangent[2], double fraction, double part, double jump_m,
                               double half_length_m) {
    const struct hd_slot *slot = &context->state->slots[index];
    const double *velocity = context->input->velocity_m_per_s;
    const double damping_n = -surface->damping_n_s_per_m * hd_dot(velocity, point->normal);
    const double from_n = slot->last.depth_m > 0.0 ? slot->normal_n : damping_n;
    const double to_n = surface->stiffness_n_per_m * (point->depth_m - surface->lowering_m) + damping_n;
    const double way_m = part * (point->arc_m + jump_m - slot->last.arc_m);
    struct hd_stretch stretch = {
        .from_m = slot->last.arc_m,
        .to_m = part < 1.0 ? slot->last.arc_m + way_m : point->arc_m + jump_m,
        .from_fraction = fraction,
        .to_fraction = fraction + part * (1.0 - fraction),
        .from_n = from_n,
        .to_n = from_n + part * (to_n - from_n),
        .half_length_m = half_length_m,
        .tangent = {tangent[0], tangent[1]},
        .speed_m_per_s = hd_dot(velocity, tangent),
        .true_speed_m_per_s = hd_dot(context->input->true_velocity_m_per_s, tangent),
    };
    if (jump_m != 0.0 && hd_magnitude(stretch.to_m) >= half_length_m) {
        const double bottom = (1.0 + HD_GROOVE_SEAM) * half_length_m;
        const double end = stretch.to_m > 0.0 ? bottom : -bottom;
        const double first_part = (end - stretch.from_m) / (stretch.to_m - stretch.from_m);
        struct hd_stretch first = stretch;
        first.to_m = end;
        first.to_fraction = stretch.from_fraction + first_part * (stretch.to_fraction - stretch.from_fraction);
        first.to_n = stretch.from_n + first_part * (stretch.to_n - stretch.from_n);
        hd_grooves_pass(context, index, object, &first);
        stretch.from_m = -end;
        stretch.from_fraction = first.to_fraction;
        stretch.from_n = first.to_n;
        stretch.to_m -= stretch.to_m > 0.0 ? 2.0 * half_length_m : -2.0 * half_length_m;
    }
    hd_grooves_pass(context, index, object, &stretch);
}

/* A contact ends. Soon after a command it may be that one's doing: the surface is another, or the way along the rest of
 * what is pressed is, so that the probe has left where it was already. Then what was pressed with was taken away. */
HD_RT static void let_go(struct hd_context *context, uint32_t index, const struct hd_object *object) {
    struct hd_slot *slot = &context->state->slots[index];
    if (slot->changed) {
        hd_contact_hush(context->state, slot);
        slot->changed = 0;
    } else if (hd_walk_is_unsettled(context) && left(context, index, object, context->from_m, &slot->last)) {
        hd_contact_force_drop(context, index);
        return;
    }
    hd_contact_end(context->state, index, context->input->time_ns);
}

/* Of a slot whose friction is still on its way over a seam. */
HD_RT static struct hd_dominant_material surface_past_seam(const struct hd_table *table, const struct hd_object *object,
                                                           double arc_m, double half_length_m, struct hd_slot *slot) {
    const double coefficient = slot->surface.friction_coefficient;
    const double stiffness = slot->surface.friction_stiffness_n_per_m;
    const struct hd_dominant_material dominant = hd_surface_at(table, object, arc_m, half_length_m, &slot->surface);
    hd_seam_ease(slot, arc_m, coefficient, stiffness);
    return dominant;
}

/* What depends on s, as far as it is there at all. */
HD_RT static void fade(struct hd_slot *slot, double arc_m, double part) {
    slot->surface.lowering_m *= part;
    slot->surface.lowering_slope *= part;
    if (!(part > 0.0)) {
        slot->anchor_m = arc_m;
    }
}

HD_RT void hd_contact_force_update(struct hd_context *context, uint32_t index, const struct hd_object *object,
                                   double fraction) {
    struct hd_state *state = context->state;
    struct hd_slot *slot = &state->slots[index];
    struct hd_contact_point point;
    find_place(context, slot, object, fraction > 0.0, &point);
    if (object->shape == HD_SHAPE_MEMBRANE && ruptures(context, index, object, &point, fraction)) {
        return;
    }
    double tangent[2];
    hd_tangent_of(slot, point.normal, tangent);
    double half_length = HD_UNBOUNDED;
    double jump = 0.0; /* of s over the bottom of a disc, where it starts again */
    struct hd_lever round;
    const struct hd_lever *lever = NULL;
    if (object->shape == HD_SHAPE_DISC) {
        const double radius = object->half_m[0];
        half_length = HD_PI * radius;
        const double step = point.arc_m - slot->last.arc_m;
        jump = step > half_length ? -2.0 * half_length : step < -half_length ? 2.0 * half_length : 0.0;
        slot->anchor_m -= jump;
        hd_disc_lever(radius, point.depth_m, &round);
        lever = &round;
    }
    const int strikes = has_strikes(context->table, object);
    /* In place: a surface on the stack that is copied as a whole right after it was written costs a third of a touch.
     */
    struct hd_surface *surface = &slot->surface;
    const struct hd_dominant_material dominant =
        slot->seam > 0 ? surface_past_seam(context->table, object, point.arc_m, half_length, slot)
                       : hd_surface_at(context->table, object, point.arc_m, half_length, surface);
    if (lever != NULL && lever->fade < 1.0) {
        fade(slot, point.arc_m, lever->fade);
    }
    if (left(context, index, object, context->input->position_m, &point)) {
        if (strikes) {
            pass_grooves(context, index, object, &point, surface, tangent, fraction, until_left(slot, object, &point),
                         jump, half_length);
        }
        let_go(context, index, object);
        return;
    }

    double pressed[2];
    const double normal_n =
        press(surface, &point, context->input->velocity_m_per_s, tangent, lever, &slot->anchor_m, pressed);
    if (strikes) {
        pass_grooves(context, index, object, &point, surface, tangent, fraction, 1.0, jump, half_length);
    } else if (slot->held) {
        hd_grooves_arm(slot, point.arc_m, half_length);
    }
    slot->normal_n = normal_n; /* amplitudes follow the force without its ramp */
    if (slot->ramp < 1.0) {
        pressed[0] *= slot->ramp;
        pressed[1] *= slot->ramp;
        slot->ramp += context->ramp_step;
        slot->ramp = slot->ramp < 1.0 ? slot->ramp : 1.0;
    }
    for (int axis = 0; axis < 2; axis++) {
        slot->force_n[axis] = pressed[0] * point.normal[axis] + pressed[1] * tangent[axis];
        context->force_n[axis] += slot->force_n[axis];
    }
    const int changed = slot->changed;
    if (changed) {
        const double none[2] = {-slot->force_n[0], -slot->force_n[1]};
        hd_contact_change(state, none);
        slot->changed = 0;
    }

    if (dominant.material->texture == HD_TEXTURE_NOISE && state->show_vibration > 0.0) {
        sound(context, index, &dominant, point.normal, tangent, hd_dot(context->input->velocity_m_per_s, tangent),
              changed);
    } else if (dominant.material->texture != HD_TEXTURE_NOISE) {
        if (changed) {
            hd_contact_hush(state, slot);
        }
        hd_contact_silence(state, slot);
    }
    slot->last = point;
}
