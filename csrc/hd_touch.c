/* The tick of a surface that is touched: where, of what, and with which force.
 *
 * F = F_n n + F_t t, with e = d - H(s) the depth below the surface as geometry has it,
 *     F_n = max(0, K e + D v_n) while e > 0, else 0
 *     F_t = K e H' - K'/2 e^2 (while e > 0)  - drag v_t  + friction,
 * v_n = -v.n, v_t = v.t; see hd_skin.h for K, H and their slopes. Vibration (grooves, noise) is added to that and never
 * gated by it. On a disc of radius R the probe at r goes r/R of the way that s goes, so there the first two terms of
 * F_t are R/r as large. A changed object comes in over the ramp: its place is blended with the plane that it was, its
 * skin with the one that was felt. */
#include <math.h>

#include "hd_contact.h"
#include "hd_friction.h"
#include "hd_groove.h"
#include "hd_skin.h"

#define HD_PI 3.14159265358979323846
#define HD_UNBOUNDED 1e300

/* The tangent of a surface; of a membrane that was entered from below it stays that of its own normal. */
HD_RT static void tangent_of(const struct hd_slot *slot, const double normal[2], double tangent[2]) {
    hd_tangent(normal, tangent);
    if (slot->side < 0) {
        tangent[0] = -tangent[0];
        tangent[1] = -tangent[1];
    }
}

/* Of a disc. A skin that is on its way to another one still has the friction of what it was. */
HD_RT static int needs_along(const struct hd_table *table, const struct hd_slot *slot, const struct hd_object *object) {
    const struct hd_material *material = &table->materials[object->material];
    return material->friction_coefficient > 0.0 || material->texture != HD_TEXTURE_NONE || slot->skin_blend < 1.0 ||
           slot->skin_version != object->skin_version;
}

HD_RT static void find_place(const struct hd_walk *walk, const struct hd_slot *slot, const struct hd_object *object,
                             struct hd_place *place) {
    const double *position = walk->input->position_m;
    switch (object->shape) {
    case HD_SHAPE_WALL:
        hd_wall_place(object, position, place);
        break;
    case HD_SHAPE_MEMBRANE:
        hd_membrane_place(object, slot->side, position, place);
        break;
    case HD_SHAPE_BOX:
        hd_box_place(object, slot->face, position, place);
        break;
    default: {
        double way[2];
        hd_difference(position, walk->from_m, way);
        const int moved = slot->moving || slot->place_version != object->place_version;
        const double travel = moved ? HD_DISC_MOVED : hd_root(hd_dot(way, way));
        hd_disc_place(object, slot->last.normal, travel, needs_along(walk->table, slot, object), position, place);
        break;
    }
    }
}

/* Works out where along a disc the probe was at the last tick. */
HD_RT static void know_along(struct hd_slot *slot, const struct hd_object *object) {
    HD_RT_FOREIGN_BEGIN
    const double along_m = object->half_m[0] * atan2(slot->last.normal[0], slot->last.normal[1]);
    HD_RT_FOREIGN_END
    slot->anchor_m += along_m - slot->last.along_m;
    slot->last.along_m = along_m;
}

/* s within half a circumference of `near_m`; `round_m` is 0 where s does not go round. */
HD_RT static double unwound(double along_m, double near_m, double round_m) {
    const double away = along_m - near_m;
    return away > 0.5 * round_m ? along_m - round_m : away < -0.5 * round_m ? along_m + round_m : along_m;
}

/* Between what the surface was when it changed and what it is now, height and place along it as they are at the probe:
 * the points themselves may lie anywhere. Round a disc s goes the shorter way. */
HD_RT static void blend_place(const struct hd_walk *walk, struct hd_slot *slot, double round_m,
                              struct hd_place *place) {
    slot->place_blend += walk->ramp_step;
    if (slot->place_blend >= 1.0) {
        slot->place_blend = 1.0;
        slot->moving = 0;
        return;
    }
    const struct hd_plane *from = &slot->from_plane;
    const double b = slot->place_blend;
    const double a = 1.0 - b;
    double offset[2];
    double tangent[2];
    hd_difference(walk->input->position_m, from->point_m, offset);
    tangent_of(slot, from->normal, tangent);
    /* However far a surface went away, what it pressed with goes within the ramp, not faster. */
    const double ahead = place->depth_m > 0.0 ? place->depth_m : 0.0;
    place->depth_m = b * ahead - a * hd_dot(offset, from->normal);
    const double before = from->along_m + hd_dot(offset, tangent);
    place->along_m = unwound(b * unwound(place->along_m, before, round_m) + a * before, 0.0, round_m);
    for (int axis = 0; axis < 2; axis++) {
        place->normal[axis] = b * place->normal[axis] + a * from->normal[axis];
    }
    const double length = hd_root(hd_dot(place->normal, place->normal));
    place->normal[0] /= length; /* the two are at most a right angle apart */
    place->normal[1] /= length;
}

/* How much of the way since the last tick the probe goes before it leaves over the edge of a face; 1: all of it. */
HD_RT static double until_edge(const struct hd_slot *slot, const struct hd_place *place, double half) {
    if (hd_magnitude(place->along_m) <= half) {
        return 1.0;
    }
    const double edge = place->along_m > 0.0 ? half : -half;
    const double travel = place->along_m - slot->last.along_m;
    const double part = travel != 0.0 ? (edge - slot->last.along_m) / travel : 0.0;
    return part < 0.0 ? 0.0 : part > 1.0 ? 1.0 : part;
}

/* Past the rupture depth, or over the edge before that? 1: it is punctured. */
HD_RT static int ruptures(struct hd_walk *walk, uint32_t index, const struct hd_object *object,
                          const struct hd_place *place, double fraction) {
    struct hd_state *state = walk->state;
    struct hd_slot *slot = &state->slots[index];
    const struct hd_material *material = &walk->table->materials[object->material];
    const double limit = material->rupture_depth_m;
    if (!(limit > 0.0)) {
        return 0;
    }
    const double leaves = until_edge(slot, place, object->half_m[0]);
    const double from = slot->last.depth_m;
    const double deepest = from + leaves * (place->depth_m - from);
    if (!(deepest > limit)) {
        return 0;
    }
    const double part = from < limit ? (limit - from) / (place->depth_m - from) : 0.0;
    const double *direction = place->normal;
    const uint32_t event = hd_state_event(state, HD_EVENT_PUNCTURE, walk->input->time_ns);
    const struct hd_strike strike = {
        .mode = &material->rupture,
        .slot = index,
        .generation = slot->generation,
        .use = HD_MODE_RUPTURE,
        .event = event,
        .units = 1.0,
        .before_s = hd_before_tick(walk, fraction + (1.0 - fraction) * part),
        .direction = {direction[0], direction[1]},
    };
    if (event < HD_EVENT_CAPACITY) {
        struct hd_event *report = &state->events[event];
        report->slot = index;
        report->generation = slot->generation;
        report->before_tick_s = strike.before_s;
        report->speed_m_per_s = -hd_dot(walk->input->velocity_m_per_s, direction);
        report->true_speed_m_per_s = -hd_dot(walk->input->true_velocity_m_per_s, direction);
        report->amplitude_m_per_s2 = material->rupture.amplitude_per_unit;
        report->value = limit;
    }
    hd_strike_add(state, &strike);
    slot->last = *place; /* its normal says where the probe came from */
    slot->open = state->epoch;
    if (material->heals) {
        state->healing[state->healing_count++] = index;
        slot->healing_index = state->healing_count;
    }
    hd_contact_end(state, index, walk->input->time_ns);
    return 1;
}

HD_RT static int left(const struct hd_walk *walk, uint32_t index, const struct hd_object *object,
                      const struct hd_place *place) {
    switch (object->shape) {
    case HD_SHAPE_WALL:
        return !(place->depth_m > 0.0);
    case HD_SHAPE_MEMBRANE:
        return hd_membrane_left(walk, object, index, place);
    case HD_SHAPE_BOX:
        return hd_box_left(walk, object, index, walk->state->slots[index].face, place);
    default:
        return hd_disc_left(walk, object, index, place);
    }
}

HD_RT static void sound(struct hd_walk *walk, uint32_t index, const struct hd_under *under, const double normal[2],
                        const double tangent[2], double speed_m_per_s) {
    struct hd_state *state = walk->state;
    struct hd_slot *slot = &state->slots[index];
    const struct hd_table *table = walk->table;
    const struct hd_noise *noise = &table->noises[under->material->noise];
    if (slot->noise == 0) {
        if (state->free_noise_count == 0) {
            return;
        }
        slot->noise = state->free_noises[--state->free_noise_count] + 1u;
        struct hd_noise_voice *fresh = &state->noises[slot->noise - 1u];
        /* A noise that begins again within a contact (on another patch, say) is not the same one again. */
        hd_noise_start(fresh, noise, table->numbers, slot->contacts++ + index * 2654435761u);
        fresh->version = noise->version;
    }
    struct hd_noise_voice *voice = &state->noises[slot->noise - 1u];
    if (voice->version != noise->version) {
        hd_noise_turn(voice);
        voice->version = noise->version;
    }
    const double sample = under->noise * noise->force_per_unit *
                          hd_noise_next(voice, noise, table->numbers, speed_m_per_s, slot->normal_n, walk->ramp_step);
    const double *direction = noise->along_normal ? normal : tangent;
    walk->noise_n[0] += sample * direction[0];
    walk->noise_n[1] += sample * direction[1];
}

/* How much of the way since the last tick the probe was in contact, when at its end it has left. */
HD_RT static double until_left(const struct hd_slot *slot, const struct hd_object *object,
                               const struct hd_place *place) {
    double part = 1.0;
    if (!(place->depth_m > 0.0)) {
        const double rise = slot->last.depth_m - place->depth_m;
        part = rise > 0.0 ? slot->last.depth_m / rise : 0.0;
    }
    if (object->shape == HD_SHAPE_MEMBRANE || object->shape == HD_SHAPE_BOX) {
        const int side = object->shape == HD_SHAPE_BOX && slot->face % 2 != 0;
        const double edge = until_edge(slot, place, object->half_m[side]);
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
HD_RT static void pass_grooves(struct hd_walk *walk, uint32_t index, const struct hd_object *object,
                               const struct hd_place *place, const struct hd_skin *skin, const double tangent[2],
                               double fraction, double part, double jump_m, double half_length_m) {
    const struct hd_slot *slot = &walk->state->slots[index];
    const double *velocity = walk->input->velocity_m_per_s;
    const double damping_n = -skin->damping_n_s_per_m * hd_dot(velocity, place->normal);
    const double from_n = slot->last.depth_m > 0.0 ? slot->normal_n : damping_n;
    const double to_n = skin->stiffness_n_per_m * (place->depth_m - skin->lowering_m) + damping_n;
    const double way_m = part * (place->along_m + jump_m - slot->last.along_m);
    struct hd_stretch stretch = {
        .from_m = slot->last.along_m,
        .to_m = part < 1.0 ? slot->last.along_m + way_m : place->along_m + jump_m,
        .from_fraction = fraction,
        .to_fraction = fraction + part * (1.0 - fraction),
        .from_n = from_n,
        .to_n = from_n + part * (to_n - from_n),
        .half_length_m = half_length_m,
        .tangent = {tangent[0], tangent[1]},
        .speed_m_per_s = hd_dot(velocity, tangent),
        .true_speed_m_per_s = hd_dot(walk->input->true_velocity_m_per_s, tangent),
    };
    if (jump_m != 0.0 && hd_magnitude(stretch.to_m) >= half_length_m) {
        const double bottom = (1.0 + HD_GROOVE_SEAM) * half_length_m;
        const double end = stretch.to_m > 0.0 ? bottom : -bottom;
        const double first_part = (end - stretch.from_m) / (stretch.to_m - stretch.from_m);
        struct hd_stretch first = stretch;
        first.to_m = end;
        first.to_fraction = stretch.from_fraction + first_part * (stretch.to_fraction - stretch.from_fraction);
        first.to_n = stretch.from_n + first_part * (stretch.to_n - stretch.from_n);
        hd_grooves_pass(walk, index, object, &first);
        stretch.from_m = -end;
        stretch.from_fraction = first.to_fraction;
        stretch.from_n = first.to_n;
        stretch.to_m -= stretch.to_m > 0.0 ? 2.0 * half_length_m : -2.0 * half_length_m;
    }
    hd_grooves_pass(walk, index, object, &stretch);
}

HD_RT int hd_touch(struct hd_walk *walk, uint32_t index, const struct hd_object *object, double fraction) {
    struct hd_state *state = walk->state;
    struct hd_slot *slot = &state->slots[index];
    struct hd_place place;
    find_place(walk, slot, object, &place);
    if (object->shape == HD_SHAPE_DISC && slot->skin_version != object->skin_version) {
        know_along(slot, object); /* a smooth disc does without */
    }
    if (slot->place_version != object->place_version) {
        if (hd_dot(slot->last.normal, place.normal) <= 0.0) {
            hd_contact_drop(state, index, walk->input->time_ns);
            return 0;
        }
        const struct hd_place *last = &slot->last;
        slot->from_plane = (struct hd_plane){
            .point_m = {walk->from_m[0] + last->depth_m * last->normal[0],
                        walk->from_m[1] + last->depth_m * last->normal[1]},
            .normal = {last->normal[0], last->normal[1]},
            .along_m = last->along_m,
        };
        slot->place_version = object->place_version;
        slot->place_blend = 0.0;
        slot->moving = 1;
    }
    const int moved = slot->moving;
    if (moved) {
        blend_place(walk, slot, object->shape == HD_SHAPE_DISC ? 2.0 * HD_PI * object->half_m[0] : 0.0, &place);
    }
    if (object->shape == HD_SHAPE_MEMBRANE && ruptures(walk, index, object, &place, fraction)) {
        return 1;
    }
    double tangent[2];
    tangent_of(slot, place.normal, tangent);
    double half_length = HD_UNBOUNDED;
    double jump = 0.0;  /* of s over the bottom of a disc, where it starts again */
    double slide = 1.0; /* of s, over the probe's way along the tangent */
    if (object->shape == HD_SHAPE_DISC) {
        const double radius = object->half_m[0];
        half_length = HD_PI * radius;
        const double step = place.along_m - slot->last.along_m;
        jump = step > half_length ? -2.0 * half_length : step < -half_length ? 2.0 * half_length : 0.0;
        slot->anchor_m -= jump;
        slide = place.depth_m < 0.5 * radius ? radius / (radius - place.depth_m) : 2.0;
    }
    /* A surface that is on its way to another place passes under the probe; that strikes nothing. */
    const int strikes = !moved && has_strikes(walk->table, object);
    if (slot->skin_version != object->skin_version) {
        slot->skin_version = object->skin_version;
        slot->from_skin = slot->skin;
        slot->skin_blend = 0.0;
    }
    /* In place: a skin on the stack that is copied as a whole right after it was written costs a third of a touch. */
    struct hd_skin *skin = &slot->skin;
    const struct hd_under under = hd_skin_at(walk->table, object, place.along_m, half_length, skin);
    if (slot->skin_blend < 1.0) {
        slot->skin_blend += walk->ramp_step;
        if (slot->skin_blend < 1.0) {
            hd_skin_blend(&slot->from_skin, slot->skin_blend, skin);
        } else {
            slot->skin_blend = 1.0;
        }
    }
    if (left(walk, index, object, &place)) {
        if (strikes) {
            pass_grooves(walk, index, object, &place, skin, tangent, fraction, until_left(slot, object, &place), jump,
                         half_length);
        }
        if (moved) { /* it was pulled away from under the hand */
            hd_contact_drop(state, index, walk->input->time_ns);
        } else {
            hd_contact_end(state, index, walk->input->time_ns);
        }
        return 1;
    }

    const double *velocity = walk->input->velocity_m_per_s;
    const double along_speed = hd_dot(velocity, tangent);
    const double depth = place.depth_m - skin->lowering_m;
    double normal_n = 0.0;
    double tangent_n = -skin->drag_n_s_per_m * along_speed;
    if (depth > 0.0) {
        const double elastic = skin->stiffness_n_per_m * depth;
        const double whole = elastic - skin->damping_n_s_per_m * hd_dot(velocity, place.normal);
        normal_n = whole > 0.0 ? whole : 0.0;
        tangent_n += slide * (elastic * skin->lowering_slope - 0.5 * skin->stiffness_slope * depth * depth);
    }
    tangent_n += hd_friction(skin, normal_n, place.along_m, &slot->anchor_m);
    if (strikes) {
        pass_grooves(walk, index, object, &place, skin, tangent, fraction, 1.0, jump, half_length);
    } else if (slot->held) {
        hd_grooves_arm(slot, place.along_m, half_length);
    }
    slot->normal_n = normal_n; /* amplitudes follow the force without its ramp */
    if (slot->ramp < 1.0) {
        normal_n *= slot->ramp;
        tangent_n *= slot->ramp;
        slot->ramp += walk->ramp_step;
        slot->ramp = slot->ramp < 1.0 ? slot->ramp : 1.0;
    }
    for (int axis = 0; axis < 2; axis++) {
        slot->force_n[axis] = normal_n * place.normal[axis] + tangent_n * tangent[axis];
        walk->force_n[axis] += slot->force_n[axis];
    }

    if (under.material->texture == HD_TEXTURE_NOISE && state->show_vibration > 0.0) {
        sound(walk, index, &under, place.normal, tangent, along_speed);
    } else if (under.material->texture != HD_TEXTURE_NOISE) {
        hd_contact_silence(state, slot);
    }
    slot->last = place;
    return 1;
}
