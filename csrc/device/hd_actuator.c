/* A lagging actuator: its response over a step is a power series whose coefficients are computed once and evaluated in
 * each step. */
#include "device/hd_actuator.h"

double hd_actuator_fastest(const struct hd_sim_config *config) {
    const double rate = config->actuator_rate_per_s;
    const double damped = 2.0 * config->actuator_damping_ratio * rate;
    return config->actuator_order == 0 ? 0.0 : config->actuator_order == 1 || damped < rate ? rate : damped;
}

void hd_actuator_make(struct hd_actuator *actuator, const struct hd_sim_config *config, double mass_kg, double damped,
                      double elastic) {
    *actuator = (struct hd_actuator){.order = config->actuator_order, .fastest_per_s = hd_actuator_fastest(config)};
    if (actuator->order == 0) {
        return;
    }
    const double rate = config->actuator_rate_per_s;
    const int second = actuator->order == 2;
    for (int start = 0; start < 2; start++) {
        double off[HD_ACTUATOR_TERMS + 1]; /* derivatives of e at the start of the step */
        off[0] = start == 0 ? 1.0 : 0.0;
        off[1] = start == 0 ? (second ? 0.0 : -rate) : second ? 1.0 : 0.0;
        for (int n = 2; n <= HD_ACTUATOR_TERMS; n++) {
            off[n] = second ? -2.0 * config->actuator_damping_ratio * rate * off[n - 1] - rate * rate * off[n - 2]
                            : -rate * off[n - 1];
        }
        /* x^(n + 2) = e_n/M - B/M x^(n + 1) - k/M x^(n), starting at rest. */
        double before = 0.0;
        double now = 0.0;
        double factorial = 1.0;
        for (int n = 0; n <= HD_ACTUATOR_TERMS; n++) {
            factorial *= n > 0 ? n : 1;
            actuator->shown[start][n] = off[n] / factorial;
            if (n < HD_ACTUATOR_TERMS) {
                const double next = off[n] / mass_kg - damped * now - elastic * before;
                actuator->moved[start][n] = next / (factorial * (n + 1) * (n + 2));
                before = now;
                now = next;
            }
        }
    }
}

HD_RT void hd_actuator_step_at(const struct hd_actuator *actuator, double span_s, struct hd_actuator_step *step) {
    for (int start = 0; start < 2; start++) {
        const double *shown = actuator->shown[start];
        const double *moved = actuator->moved[start];
        double off = shown[HD_ACTUATOR_TERMS];
        double rise = 0.0;
        double x = 0.0;
        double v = 0.0;
        for (int n = HD_ACTUATOR_TERMS - 1; n >= 0; n--) {
            rise = rise * span_s + (n + 1) * shown[n + 1];
            off = off * span_s + shown[n];
            x = x * span_s + moved[n];
            v = v * span_s + (n + 2) * moved[n];
        }
        step->off_n[start] = off;
        step->off_n_per_s[start] = rise;
        step->x_m[start] = x * span_s * span_s;
        step->v_m_per_s[start] = v * span_s;
    }
}
