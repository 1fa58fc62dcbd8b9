/* Which way the vibration of a tap and of a rupture pushes first. */
#ifndef HD_AIM_H
#define HD_AIM_H

#include "base/hd_vector.h"
#include "tick/hd_state.h"

/* The tangent of a surface; of a membrane that was entered from below it stays that of its own normal. */
HD_RT static inline void hd_tangent_of(const struct hd_slot *slot, const double normal[2], double tangent[2]) {
    hd_tangent(normal, tangent);
    if (slot->feature.side < 0) {
        tangent[0] = -tangent[0];
        tangent[1] = -tangent[1];
    }
}

/* Adds a strike along a material's aim (hd_api.h), at a place with this normal. Overwrites the strike's direction. */
HD_RT void hd_aim_strike(struct hd_state *state, const struct hd_slot *slot, const double aim[2],
                         const double normal[2], struct hd_strike *strike);

#endif
