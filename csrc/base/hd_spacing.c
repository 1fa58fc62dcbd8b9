/* The usual time between arrivals: the mean of spacings without the shortest and the longest. */
#include "base/hd_spacing.h"

HD_RT void hd_spacing_add(struct hd_spacing *spacing, double spacing_s) {
    spacing->spacing_s[spacing->next] = spacing_s;
    spacing->next = (spacing->next + 1u) % HD_SPACINGS;
    spacing->count += spacing->count < HD_SPACINGS;
}

HD_RT double hd_spacing_usual(const struct hd_spacing *spacing, double otherwise) {
    if (spacing->count == 0) {
        return otherwise;
    }
    double sum_s = 0.0;
    uint32_t shortest = 0;
    uint32_t longest = 0;
    for (uint32_t i = 0; i < spacing->count; i++) {
        shortest = spacing->spacing_s[i] < spacing->spacing_s[shortest] ? i : shortest;
        longest = spacing->spacing_s[i] >= spacing->spacing_s[longest] ? i : longest;
    }
    const int trims = spacing->count > 2u;
    for (uint32_t i = 0; i < spacing->count; i++) {
        sum_s += trims && (i == shortest || i == longest) ? 0.0 : spacing->spacing_s[i];
    }
    return sum_s / (double)(trims ? spacing->count - 2u : spacing->count);
}
