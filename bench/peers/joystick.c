/* Ways to move a handle through one period under a held force, for bench/joystick.py:
 *
 *     M x'' = F - b x' - b_h (x' - w') - k (x - w) - c sign(x')
 *
 * with the reference w straight between waypoints. The Eulers and Runge and Kutta's method take one step a period, as a
 * simulation at the servo's rate would; friction is held at what it is at the step's beginning, and a handle that would
 * turn within the step, or is pushed with less than the friction, rests. csrc/device/hd_sim.h is called as the servo
 * does. */
#include <math.h>

#include "device/hd_operator.h"
#include "device/hd_sim.h"
#include "peers.h"

struct motion {
    double x;
    double v;
};

struct reference {
    const double *waypoints;
    size_t points;
    size_t next;
};

/* The reference and its speed, `time_s` never falling by more than a step; at a waypoint the speed is that of what
 * comes. */
static void reference_at(struct reference *reference, double time_s, double *w, double *rate) {
    const double *points = reference->waypoints;
    while (reference->next < reference->points && time_s >= points[2 * reference->next] * (1.0 - 1e-12)) {
        reference->next++;
    }
    if (reference->next == reference->points) {
        *w = points[2 * reference->points - 1];
        *rate = 0.0;
        return;
    }
    const double *from = points + 2 * (reference->next - 1);
    *rate = (from[3] - from[1]) / (from[2] - from[0]);
    *w = from[1] + *rate * (time_s - from[0]);
}

static inline double pulled(const struct peer_handle *h, double force, double w, double rate, struct motion at) {
    return force + h->hand_stiffness_n_per_m * (w - at.x) + h->hand_damping_n_s_per_m * (rate - at.v) -
           h->damping_n_s_per_m * at.v;
}

static inline struct motion stepped(int kind, const struct peer_handle *h, double period_s, double force, double w,
                                    double rate, struct motion at) {
    const double t = period_s;
    const double pull = pulled(h, force, w, rate, at);
    if (at.v == 0.0 && fabs(pull) <= h->friction_n) {
        return at;
    }
    const double direction = at.v > 0.0 ? 1.0 : at.v < 0.0 ? -1.0 : pull > 0.0 ? 1.0 : -1.0;
    const double push = force - direction * h->friction_n;
    const double a = (pull - direction * h->friction_n) / h->mass_kg;
    struct motion to;
    if (kind == PEER_JOYSTICK_EULER) {
        to = (struct motion){at.x + t * at.v, at.v + t * a};
    } else if (kind == PEER_JOYSTICK_SEMI_IMPLICIT) {
        const double v = at.v + t * a;
        to = (struct motion){at.x + t * v, v};
    } else {
        const double middle = w + 0.5 * t * rate;
        const struct motion p2 = {at.x + 0.5 * t * at.v, at.v + 0.5 * t * a};
        const double a2 = pulled(h, push, middle, rate, p2) / h->mass_kg;
        const struct motion p3 = {at.x + 0.5 * t * p2.v, at.v + 0.5 * t * a2};
        const double a3 = pulled(h, push, middle, rate, p3) / h->mass_kg;
        const struct motion p4 = {at.x + t * p3.v, at.v + t * a3};
        const double a4 = pulled(h, push, w + t * rate, rate, p4) / h->mass_kg;
        to = (struct motion){at.x + t / 6.0 * (at.v + 2.0 * p2.v + 2.0 * p3.v + p4.v),
                             at.v + t / 6.0 * (a + 2.0 * a2 + 2.0 * a3 + a4)};
    }
    if (h->friction_n > 0.0 && to.v * direction < 0.0) {
        to.v = 0.0;
    }
    return to;
}

static double simulated(const struct peer_handle *h, double period_s, size_t points, const double *waypoints,
                        size_t count, const double *force, double *position) {
    double path[64][3];
    for (size_t i = 0; i < points && i < 64; i++) {
        path[i][0] = waypoints[2 * i];
        path[i][1] = path[i][2] = waypoints[2 * i + 1];
    }
    const struct hd_sim_config config = {
        .handle_mass_kg = h->mass_kg,
        .handle_damping_n_s_per_m = h->damping_n_s_per_m,
        .coulomb_friction_n = h->friction_n,
        .max_force_n = 1e3,
        .workspace_m = 10.0,
        .force_timeout_s = 0.1,
        .hand_stiffness_n_per_m = h->hand_stiffness_n_per_m,
        .hand_damping_n_s_per_m = h->hand_damping_n_s_per_m,
    };
    struct hd_sim *sim = points <= 64 ? hd_sim_new(&config, period_s) : NULL;
    struct hd_operator *hand = sim != NULL ? hd_operator_new(&path[0][0], points, HD_LINEAR) : NULL;
    double taken = -1.0;
    if (hand != NULL) {
        double place[2];
        double velocity[2];
        double acting[2];
        hd_sim_operate(sim, hand);
        hd_sim_settle(sim);
        const double start_ns = peer_clock_ns();
        for (size_t k = 0; k < count; k++) {
            const double both[2] = {force[k], force[k]};
            hd_sim_step_truth(sim, place, velocity, acting);
            position[k] = place[0];
            hd_sim_step_put(sim, both);
            hd_sim_step_advance(sim, 1);
        }
        taken = peer_clock_ns() - start_ns;
        hd_sim_step_truth(sim, place, velocity, acting);
        position[count] = place[0];
    }
    hd_operator_free(hand);
    hd_sim_free(sim);
    return taken;
}

static inline void walk(int kind, const struct peer_handle *h, double period_s, size_t points, const double *waypoints,
                        size_t count, const double *force, double *position) {
    struct reference reference = {waypoints, points, 1};
    struct motion axes[2] = {{0.0, 0.0}, {0.0, 0.0}};
    for (size_t k = 0; k < count; k++) {
        double w;
        double rate;
        position[k] = axes[0].x;
        reference_at(&reference, (double)k * period_s, &w, &rate);
        for (int axis = 0; axis < 2; axis++) {
            axes[axis] = stepped(kind, h, period_s, force[k], w, rate, axes[axis]);
        }
    }
    position[count] = axes[0].x;
}

double peer_joystick(int kind, const struct peer_handle *handle, double period_s, size_t points,
                     const double *waypoints, size_t count, const double *force, double *position) {
    if (kind == PEER_JOYSTICK_EXACT) {
        return simulated(handle, period_s, points, waypoints, count, force, position);
    }
    const double start_ns = peer_clock_ns();
    if (kind == PEER_JOYSTICK_EULER) {
        walk(PEER_JOYSTICK_EULER, handle, period_s, points, waypoints, count, force, position);
    } else if (kind == PEER_JOYSTICK_SEMI_IMPLICIT) {
        walk(PEER_JOYSTICK_SEMI_IMPLICIT, handle, period_s, points, waypoints, count, force, position);
    } else {
        walk(PEER_JOYSTICK_RK4, handle, period_s, points, waypoints, count, force, position);
    }
    return peer_clock_ns() - start_ns;
}
