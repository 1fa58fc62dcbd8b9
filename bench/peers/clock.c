#include <stddef.h>
#include <stdint.h>
#include <time.h>

#include "peers.h"

double peer_clock_ns(void) {
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)now.tv_sec * 1e9 + (double)now.tv_nsec;
}
