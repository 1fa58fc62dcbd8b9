/* Coloured noise: white numbers through a normalised lattice (Gray and Markel), levelled by speed and force.
 *
 * Each stage of a normalised lattice is a rotation, so with white input of unit power every state keeps unit power
 * exactly, however fast the coefficients change; the direct form diverges under fast change even when every frozen
 * filter is stable. Servo thread, or the caller's of an offline run. */
#ifndef HD_NOISE_H
#define HD_NOISE_H

#include "hd_core.h"
#include "hd_rt.h"

/* One noise that sounds. A field with `_from` is what its namesake was when the last ramp began. */
struct hd_noise_voice {
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
    double delay[HD_NOISE_ORDER + 1]; /* b_m of the sample before; those beyond the order are kept for later */
    double sine[HD_NOISE_ORDER];      /* k_1 .. k_order */
    double cosine[HD_NOISE_ORDER];    /* sqrt(1 - k^2) */
    double tap[HD_NOISE_ORDER + 1];   /* v_0 .. v_order */
    double sine_from[HD_NOISE_ORDER]; /* 0 beyond the order that was */
    double tap_from[HD_NOISE_ORDER + 1];
};

/* Begins: the lattice in its stationary state, drawn from the noise's seed and `salt` (the same two give the same
 * samples). Leaves voice->version as it is. */
HD_RT void hd_noise_start(struct hd_noise_voice *voice, const struct hd_noise *noise, const double *numbers,
                          uint32_t salt);
/* Another noise, or the same one changed: coefficients and RMS move from where they are to it over the next ramp; the
 * state stays. To be called before hd_noise_next sees the other noise, or the same one with other numbers. */
HD_RT void hd_noise_turn(struct hd_noise_voice *voice);
/* The next sample, m/s^2. At an RMS of zero it is 0 and nothing moves on, not even a ramp; so it is at a speed of
 * exactly zero. `ramp_step`: what a ramp moves on in a tick. */
HD_RT double hd_noise_next(struct hd_noise_voice *voice, const struct hd_noise *noise, const double *numbers,
                           double speed_m_per_s, double force_n, double ramp_step);

#endif
