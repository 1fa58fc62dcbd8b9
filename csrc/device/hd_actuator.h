/* A lagging actuator of first or second order, on a handle that a hand holds.
 *
 * Its force is F = u + e, where u is the commanded force (held from put to put) and the error e decays freely:
 *
 *     order 1:  e' = -a e                  order 2:  e'' = -2 zeta a e' - a^2 e
 *
 * F is continuous when a new u is put, so e takes the step. The effect of e on M x'' + B x' + k x = F is linear in (e,
 * e') at the start of a step. The coefficients of its power series are computed once; the series is exact to rounding
 * while the step times the fastest rate is at most 1/2. A device without a lag has order 0, which costs one
 * comparison. */
#ifndef HD_ACTUATOR_H
#define HD_ACTUATOR_H

#include "api/hd_core.h"
#include "base/hd_rt.h"

#define HD_ACTUATOR_TERMS 16 /* terms of the power series */

struct hd_actuator {
    uint32_t order;
    double fastest_per_s;                   /* fastest rate of the lag */
    double shown[2][HD_ACTUATOR_TERMS + 1]; /* series of e for the initial values (e, e') = (1, 0) and (0, 1): e_n/n! */
    double moved[2][HD_ACTUATOR_TERMS];     /* series of the position that each causes, divided by h^2 */
};

/* (e, e') and the motion after one step, for the initial values (1, 0) and (0, 1). */
struct hd_actuator_step {
    double off_n[2];
    double off_n_per_s[2];
    double x_m[2];
    double v_m_per_s[2];
};

/* Control side. `elastic` and `damped` are k/M and B/M. */
void hd_actuator_make(struct hd_actuator *actuator, const struct hd_sim_config *config, double mass_kg, double damped,
                      double elastic);
/* Returns the fastest rate of the configured lag, 1/s; 0: no lag. */
double hd_actuator_fastest(const struct hd_sim_config *config);

HD_RT void hd_actuator_step_at(const struct hd_actuator *actuator, double span_s, struct hd_actuator_step *step);

#endif
