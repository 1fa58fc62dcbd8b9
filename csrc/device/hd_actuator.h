/* An actuator that lags behind what it is told, of first or second order, on a handle that a hand holds.
 *
 * Its force is F = u + e, u what it was told last (held from put to put) and e what it is off by, which decays by
 * itself:
 *
 *     order 1:  e' = -a e                  order 2:  e'' = -2 zeta a e' - a^2 e
 *
 * F goes on without a step where u is put anew, so that e takes the step. What e does to M x'' + B x' + k x = F is
 * linear in (e, e') at the beginning of a step; the power series of it, exact to rounding while the fastest of all
 * rates times the step is at most 1/2, are made once. A device without such a lag has order 0 and pays a comparison. */
#ifndef HD_ACTUATOR_H
#define HD_ACTUATOR_H

#include "api/hd_core.h"
#include "base/hd_rt.h"

#define HD_ACTUATOR_TERMS 16

struct hd_actuator {
    uint32_t order;
    double fastest_per_s;                   /* no part of it is faster */
    double shown[2][HD_ACTUATOR_TERMS + 1]; /* series of e that began as (1, 0) and as (0, 1): e_n/n! */
    double moved[2][HD_ACTUATOR_TERMS];     /* of the position that each causes, but for a factor h^2 */
};

/* What (e, e') become and do in one step, for those two beginnings. */
struct hd_actuator_step {
    double off_n[2];
    double off_n_per_s[2];
    double x_m[2];
    double v_m_per_s[2];
};

/* Control side. `elastic` and `damped` are k/M and B/M. */
void hd_actuator_make(struct hd_actuator *actuator, const struct hd_sim_config *config, double mass_kg, double damped,
                      double elastic);
/* The fastest rate of what a configuration asks for, 1/s; 0: it acts at once. */
double hd_actuator_fastest(const struct hd_sim_config *config);

HD_RT void hd_actuator_step_at(const struct hd_actuator *actuator, double span_s, struct hd_actuator_step *step);

#endif
