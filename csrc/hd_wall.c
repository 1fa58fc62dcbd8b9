/* Walls: half planes. d = -(p - p0).n, F = max(0, K d + D v_n) n while d > 0, and a tap at the onset. */
#include "hd_contact.h"

HD_RT static double depth_at(const struct hd_surface *surface, const double position_m[2]) {
    const double offset[2] = {position_m[0] - surface->point_m[0], position_m[1] - surface->point_m[1]};
    return -hd_dot(offset, surface->normal);
}

HD_RT void hd_walls_walk(struct hd_walk *walk) {
    const uint32_t count = walk->table->wall_count;
    for (uint32_t i = 0; i < count; i++) {
        const struct hd_wall *wall = &walk->table->walls[i];
        struct hd_slot *slot = hd_contact_slot(walk, &wall->key);
        const struct hd_surface *surface = &wall->surface;
        if (slot->touched) {
            hd_contact_follow(walk, slot, &wall->key, surface);
            surface = slot->touched ? &slot->now : surface;
        }
        const double depth = depth_at(surface, walk->input->position_m);
        if (!(depth > 0.0)) {
            slot->known = 1;
            if (slot->touched) {
                hd_contact_end(walk->state, wall->key.slot, walk->input->time_ns);
            }
            continue;
        }
        if (!slot->touched) {
            struct hd_onset onset = {.silent = 1, .direction = {surface->normal[0], surface->normal[1]}};
            if (slot->known && !walk->resync) {
                const double before = depth_at(surface, walk->from_m);
                if (before <= 0.0) {
                    onset.silent = 0;
                    onset.before_s = hd_before_tick(walk, before / (before - depth));
                }
            }
            hd_contact_begin(walk, slot, &wall->key, surface, &wall->tap, &onset);
        }
        slot->known = 1;
        hd_contact_push(walk, slot, depth, slot->now.normal);
    }
}
