/* Adds strikes along the direction that the material gives. The stiffness of a surface acts along its normal n and not
 * along its tangent t, so a mode that is compensated for stiffness is struck along n and along t separately: two
 * strikes of one active mode. Every other mode is struck once. */
#include "tick/hd_aim.h"

#include "tick/hd_strike.h"

HD_RT void hd_aim_strike(struct hd_state *state, const struct hd_slot *slot, const double aim[2],
                         const double normal[2], struct hd_strike *strike) {
    strike->direction[0] = normal[0];
    strike->direction[1] = normal[1];
    if (aim[0] == 0.0 && aim[1] == 0.0) {
        hd_strike_add(state, strike);
        return;
    }
    double tangent[2];
    hd_tangent_of(slot, normal, tangent);
    if (strike->mode->touched_n_per_m > 0.0 && strike->mode->effect == 0 && aim[0] != 0.0 && aim[1] != 0.0) {
        struct hd_strike part = *strike;
        part.units = hd_magnitude(aim[0]) * strike->units;
        part.direction[0] = aim[0] > 0.0 ? normal[0] : -normal[0];
        part.direction[1] = aim[0] > 0.0 ? normal[1] : -normal[1];
        hd_strike_add(state, &part);
        part.units = hd_magnitude(aim[1]) * strike->units;
        part.growth_n = 0.0; /* counted with the first part */
        part.lifts = 0;
        part.direction[0] = aim[1] > 0.0 ? tangent[0] : -tangent[0];
        part.direction[1] = aim[1] > 0.0 ? tangent[1] : -tangent[1];
        hd_strike_add(state, &part);
        return;
    }
    strike->lifts = aim[0] != 0.0;
    strike->direction[0] = aim[0] * normal[0] + aim[1] * tangent[0];
    strike->direction[1] = aim[0] * normal[1] + aim[1] * tangent[1];
    hd_strike_add(state, strike);
}
