/* Membranes: a spring along the normal on the side entered, until it ruptures.
 *
 * A membrane is a segment of half width w about its centre. It is entered when the straight line between two samples
 * crosses it, so nothing tunnels through at any speed. h = (p - c).n is the height over it; entered from side s (+1 or
 * -1), the deflection is d = -s h. Beyond the rupture depth the force is zero at that tick and the rupture mode is
 * struck along s n. Leaving over the edge is a release. A punctured membrane stays open until it is reset or, if it
 * heals, until the probe is back on the side that it came from. */
#include "hd_contact.h"

HD_RT static int8_t sign_of(double value) {
    return value > 0.0 ? 1 : value < 0.0 ? -1 : 0;
}

/* Height over the surface and coordinate along it, from the centre. */
struct place {
    double height;
    double along;
};

HD_RT static struct place place_of(const struct hd_surface *surface, const double position_m[2]) {
    const double offset[2] = {position_m[0] - surface->point_m[0], position_m[1] - surface->point_m[1]};
    const double tangent[2] = {surface->normal[1], -surface->normal[0]};
    return (struct place){hd_dot(offset, surface->normal), hd_dot(offset, tangent)};
}

HD_RT static double magnitude(double value) {
    return value < 0.0 ? -value : value;
}

HD_RT static void puncture(struct hd_walk *walk, struct hd_slot *slot, const struct hd_membrane *membrane,
                           double fraction) {
    struct hd_state *state = walk->state;
    const struct hd_surface *surface = &slot->now;
    const double direction[2] = {(double)slot->side * surface->normal[0], (double)slot->side * surface->normal[1]};
    const uint32_t event = hd_state_event(state, HD_EVENT_PUNCTURE, walk->input->time_ns);
    const struct hd_strike strike = {
        .mode = &membrane->rupture,
        .slot = membrane->key.slot,
        .generation = membrane->key.generation,
        .use = HD_MODE_RUPTURE,
        .event = event,
        .units = 1.0,
        .before_s = hd_before_tick(walk, fraction),
        .direction = {direction[0], direction[1]},
    };
    if (event < HD_EVENT_CAPACITY) {
        struct hd_event *report = &state->events[event];
        report->slot = membrane->key.slot;
        report->generation = membrane->key.generation;
        report->before_tick_s = strike.before_s;
        report->speed_m_per_s = -hd_dot(walk->input->velocity_m_per_s, direction);
        report->true_speed_m_per_s = -hd_dot(walk->input->true_velocity_m_per_s, direction);
        report->amplitude_m_per_s2 = membrane->rupture.amplitude_per_unit;
        report->value = surface->rupture_depth_m;
    }
    hd_strike_add(state, &strike);
    slot->open = 1;
    hd_contact_end(state, membrane->key.slot, walk->input->time_ns);
}

/* The tick of a membrane that is touched: release, rupture or force. */
HD_RT static void press(struct hd_walk *walk, struct hd_slot *slot, const struct hd_membrane *membrane) {
    const struct hd_surface *surface = &slot->now;
    const double side = (double)slot->side;
    const struct place from = place_of(surface, walk->from_m);
    const struct place to = place_of(surface, walk->input->position_m);
    const double depth_from = -side * from.height;
    const double depth_to = -side * to.height;
    /* Where, between the samples, the probe leaves over the edge; 1: it does not. */
    double leaves = 1.0;
    const int outside = magnitude(to.along) > surface->half_width_m;
    if (outside) {
        const double edge = to.along > 0.0 ? surface->half_width_m : -surface->half_width_m;
        const double travel = to.along - from.along;
        leaves = travel != 0.0 ? (edge - from.along) / travel : 0.0;
        leaves = leaves < 0.0 ? 0.0 : leaves > 1.0 ? 1.0 : leaves;
    }
    const double deepest = depth_from + leaves * (depth_to - depth_from);
    const double limit = surface->rupture_depth_m;
    if (limit > 0.0 && deepest > limit) {
        const double fraction = depth_from < limit ? (limit - depth_from) / (depth_to - depth_from) : 0.0;
        puncture(walk, slot, membrane, fraction);
    } else if (outside || !(depth_to > 0.0)) {
        hd_contact_end(walk->state, membrane->key.slot, walk->input->time_ns);
    } else {
        const double direction[2] = {side * surface->normal[0], side * surface->normal[1]};
        hd_contact_push(walk, slot, depth_to, direction);
    }
}

/* Touches the membrane from the side where the probe was; the onset's direction follows from that. */
HD_RT static void enter(struct hd_walk *walk, struct hd_slot *slot, const struct hd_membrane *membrane,
                        struct hd_onset onset) {
    const struct hd_surface *surface = &membrane->surface;
    slot->side = slot->last_side;
    onset.direction[0] = (double)slot->side * surface->normal[0];
    onset.direction[1] = (double)slot->side * surface->normal[1];
    hd_contact_begin(walk, slot, &membrane->key, surface, &membrane->tap, &onset);
    press(walk, slot, membrane);
}

/* Whether the last step crossed the closed membrane from the side where the probe was, and where. */
HD_RT static int crosses(const struct hd_walk *walk, const struct hd_slot *slot, const struct hd_surface *surface,
                         const struct place *to, double *fraction) {
    if (!slot->known || walk->resync || slot->last_side == 0 || sign_of(to->height) != -slot->last_side) {
        return 0;
    }
    const struct place from = place_of(surface, walk->from_m);
    if (sign_of(from.height) == sign_of(to->height)) {
        return 0; /* the surface moved, not the probe */
    }
    *fraction = from.height / (from.height - to->height);
    return magnitude(from.along + *fraction * (to->along - from.along)) <= surface->half_width_m;
}

/* Sides are told by the normal: they turn with it. */
HD_RT static void remember_surface(struct hd_slot *slot, const struct hd_membrane *membrane) {
    if (hd_dot(slot->now.normal, membrane->surface.normal) < 0.0) {
        slot->side = (int8_t)-slot->side;
        slot->last_side = (int8_t)-slot->last_side;
        slot->resume = (int8_t)-slot->resume;
    }
    slot->now = membrane->surface;
    slot->version = membrane->key.version;
}

/* A membrane whose contact was cleared while it was pressed is met anew from the same side: silently, over the ramp. */
HD_RT static void resume(struct hd_walk *walk, struct hd_slot *slot, const struct hd_membrane *membrane,
                         const struct place *to) {
    const struct hd_surface *surface = &membrane->surface;
    const double depth = -(double)slot->resume * to->height;
    const int inside = depth > 0.0 && magnitude(to->along) <= surface->half_width_m &&
                       (surface->rupture_depth_m == 0.0 || depth <= surface->rupture_depth_m);
    if (inside) {
        const struct hd_onset onset = {.silent = 1};
        slot->last_side = slot->resume;
        enter(walk, slot, membrane, onset);
    }
    slot->resume = 0;
}

HD_RT void hd_membranes_walk(struct hd_walk *walk) {
    const uint32_t count = walk->table->membrane_count;
    for (uint32_t i = 0; i < count; i++) {
        const struct hd_membrane *membrane = &walk->table->membranes[i];
        struct hd_slot *slot = hd_contact_slot(walk, &membrane->key);
        if (slot->touched) {
            hd_contact_follow(walk, slot, &membrane->key, &membrane->surface);
        }
        if (slot->touched) {
            press(walk, slot, membrane);
        }
        const struct place to = place_of(&membrane->surface, walk->input->position_m);
        const int8_t side = sign_of(to.height);
        if (!slot->touched && slot->version != membrane->key.version) {
            remember_surface(slot, membrane);
        }
        if (!slot->touched && !slot->open && slot->resume != 0) {
            resume(walk, slot, membrane, &to);
        }
        if (slot->open) {
            /* slot->side is where the probe came from. */
            slot->open = membrane->key.heals && side == slot->side ? 0 : 1;
        } else if (!slot->touched) {
            double fraction;
            if (crosses(walk, slot, &membrane->surface, &to, &fraction)) {
                const struct hd_onset onset = {.before_s = hd_before_tick(walk, fraction)};
                enter(walk, slot, membrane, onset);
            }
        }
        /* Pressed in, or exactly on the surface, the probe is still on the side that it came from. */
        if (!slot->touched && side != 0) {
            slot->last_side = side;
        }
        slot->known = 1;
    }
}
