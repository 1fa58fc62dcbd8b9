/* The direction in which a tap and a rupture vibrate. */
#ifndef HD_AIM_H
#define HD_AIM_H

#include "base/hd_vector.h"
#include "tick/hd_state.h"

/* Finds the tangent of a surface. A membrane that was entered from the back keeps the tangent of the object's normal.
 */
HD_RT static inline void hd_tangent_of(const struct hd_slot *slot, const double normal[2], double tangent[2]) {
    hd_tangent(normal, tangent);
    if (slot->feature.side < 0) {
        tangent[0] = -tangent[0];
        tangent[1] = -tangent[1];
    }
}

/* Adds a strike along the direction `aim` of the material (hd_api.h), given along `normal` and tangent of the contact
 * point. Overwrites the strike's direction. */
HD_RT void hd_aim_strike(struct hd_state *state, const struct hd_slot *slot, const double aim[2],
                         const double normal[2], struct hd_strike *strike);

#endif
