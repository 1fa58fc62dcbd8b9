/* Coloured noise: white numbers through a normalised lattice (Gray and Markel), levelled by speed and force.
 *
 * Each stage of a normalised lattice is a rotation, so with white input of unit power every state keeps unit power
 * exactly, however fast the coefficients change; the direct form diverges under fast change even when every frozen
 * filter is stable. Servo thread, or the caller's of an offline run. */
#ifndef HD_NOISE_H
#define HD_NOISE_H

#include "api/hd_core.h"
#include "base/hd_rt.h"

/* A number that follows its motive at once, and a command's change of it over the ramp. */
struct hd_eased {
    double now;
    double off;  /* what it is off from what it is on its way to */
    double pace; /* by which that shrinks, per ramp */
};

HD_RT static inline double hd_ease(struct hd_eased *eased, double to, int changed, double ramp_step) {
    if (changed) {
        const double off = eased->now - to;
        const double other = off - eased->off;
        /* Another change is none of this number's, and its ramp ends in its time. */
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
    uint32_t version; /* of what it plays; the caller's */
    uint32_t order;   /* stages that run */
    uint32_t taps;    /* 0 or 1 */
    uint32_t order_from;
    uint32_t taps_from;
    uint32_t cell[2]; /* of the grid, along speed and force, that the coefficients are for */
    double part[2];   /* how far into the cell, 0 to 1 */
    double blend;     /* from what was to what the table says; 1: no ramp is under way */
    double level;     /* m/s^2: the RMS before it fades towards rest */
    double level_from;
    double rms;                       /* m/s^2: of the last sample */
    struct hd_eased scale_n;          /* N per m/s^2 */
    struct hd_eased normal_n;         /* the force that the RMS follows */
    double direction[2];              /* that the last sample acted along */
    double delay[HD_NOISE_ORDER + 1]; /* b_m of the sample before; those beyond the order are kept for later */
    double sine[HD_NOISE_ORDER];      /* k_1 .. k_order */
    double cosine[HD_NOISE_ORDER];    /* sqrt(1 - k^2) */
    double tap[HD_NOISE_ORDER + 1];   /* v_0 .. v_order */
    double sine_from[HD_NOISE_ORDER]; /* 0 beyond the order that was */
    double tap_from[HD_NOISE_ORDER + 1];
};

/* Begins: the lattice in its stationary state, drawn from the noise's seed and `salt` (the same two give the same
 * samples). Leaves active->version as it is. */
HD_RT void hd_noise_start(struct hd_active_noise *active, const struct hd_noise *noise, const double *numbers,
                          uint32_t salt);
/* Another noise, or the same one changed: coefficients and RMS move from where they are to it over the next ramp; the
 * state stays. To be called before hd_noise_next sees the other noise, or the same one with other numbers. */
HD_RT void hd_noise_turn(struct hd_active_noise *active);
/* The RMS of the last sample, N. */
HD_RT static inline double hd_noise_rms(const struct hd_active_noise *active) {
    return active->scale_n.now * active->rms;
}

/* What the last sample would be now, N: of a noise that is no more. */
HD_RT double hd_noise_last(struct hd_active_noise *active);
/* The next sample, m/s^2. At an RMS of zero it is 0 and nothing moves on, not even a ramp; so it is at a speed of
 * exactly zero. `ramp_step`: what a ramp moves on in a tick. */
HD_RT double hd_noise_next(struct hd_active_noise *active, const struct hd_noise *noise, const double *numbers,
                           double speed_m_per_s, double force_n, double ramp_step);

#endif
