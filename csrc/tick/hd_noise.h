/* Coloured noise: white noise through a normalised lattice (Gray and Markel), with an RMS that follows speed and force.
 *
 * Each stage of a normalised lattice is a rotation, so with white input of unit power every state has exactly unit
 * power, however fast the coefficients change. The direct form diverges under fast changes even if every frozen filter
 * is stable. Servo thread, or the caller of an offline run. */
#ifndef HD_NOISE_H
#define HD_NOISE_H

#include "api/hd_core.h"
#include "base/hd_rt.h"

/* A value that follows its target at once, except changes by commands, which it follows over the ramp. */
struct hd_eased {
    double now;
    double off;  /* now minus the target */
    double pace; /* decrease of |off| per ramp */
};

/* Moves a value to the target `to` and returns it. `changed`: a command changed the target in this tick. */

HD_RT static inline double hd_ease(struct hd_eased *eased, double to, int changed, double ramp_step) {
    if (changed) {
        const double off = eased->now - to;
        const double other = off - eased->off;
        /* A command that left this target unchanged does not restart its ramp. */
        if (other * other > 1e-24 * to * to) {
            eased->off = off;
            eased->pace = off < 0.0 ? -off : off;
        }
    }
    if (eased->off != 0.0) {
        const double step = eased->pace * ramp_step;
        eased->off = eased->off > step ? eased->off - step : eased->off < -step ? eased->off + step : 0.0;
        to = to + eased->off > 0.0 ? to + eased->off : 0.0;
    }
    eased->now = to;
    return to;
}

/* One noise that sounds. A field with `_from` is what its namesake was when the last ramp began. */
struct hd_active_noise {
    uint64_t random;
    uint32_t version; /* of the noise in the table; kept by the caller */
    uint32_t order;   /* stages that run */
    uint32_t taps;    /* 1: the output is a sum of taps, 0: all-pole */
    uint32_t order_from;
    uint32_t taps_from;
    uint32_t cell[2]; /* cell of the grid, along speed and force, for which the coefficients were computed */
    double part[2];   /* position in the cell, 0 to 1 */
    double blend;     /* from the `_from` values, 0, to those of the table, 1: no ramp is active */
    double level;     /* m/s^2: the RMS before it fades at low speed */
    double level_from;
    double rms;                       /* m/s^2: of the last sample */
    struct hd_eased scale_n;          /* N per m/s^2 */
    struct hd_eased normal_n;         /* the force that the RMS follows */
    double direction[2];              /* of the last sample */
    double delay[HD_NOISE_ORDER + 1]; /* b_m of the previous sample; entries beyond the order keep their values */
    double sine[HD_NOISE_ORDER];      /* k_1 .. k_order */
    double cosine[HD_NOISE_ORDER];    /* sqrt(1 - k^2) */
    double tap[HD_NOISE_ORDER + 1];   /* v_0 .. v_order */
    double sine_from[HD_NOISE_ORDER]; /* 0 beyond order_from */
    double tap_from[HD_NOISE_ORDER + 1];
};

/* Starts a noise: draws the stationary state of the lattice from the noise's seed and `salt`; equal seed and salt give
 * equal samples. Does not change active->version. */
HD_RT void hd_noise_start(struct hd_active_noise *active, const struct hd_noise *noise, const double *numbers,
                          uint32_t salt);
/* Starts a ramp to another noise, or to a changed one: over the ramp coefficients and RMS move from their present
 * values to the new ones; the delays stay. Must be called before the first hd_noise_next with the new noise or numbers.
 */
HD_RT void hd_noise_turn(struct hd_active_noise *active);
/* Returns the RMS of the last sample, N. */
HD_RT static inline double hd_noise_rms(const struct hd_active_noise *active) {
    return active->scale_n.now * active->rms;
}

/* Returns the next sample of a noise that is being removed, N, with the RMS and gain of its last one. */
HD_RT double hd_noise_last(struct hd_active_noise *active);
/* Returns the next sample, m/s^2. At an RMS of zero, as at a speed of exactly zero, it is 0 and neither the lattice nor
 * a ramp advances. `ramp_step`: part of a ramp that passes in a tick, 0 to 1. */
HD_RT double hd_noise_next(struct hd_active_noise *active, const struct hd_noise *noise, const double *numbers,
                           double speed_m_per_s, double force_n, double ramp_step);

#endif
