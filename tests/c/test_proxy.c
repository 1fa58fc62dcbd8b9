/* The proxy stays near the probe: its distance from it, and its step when another surface begins to be pressed. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "base/hd_vector.h"
#include "hd_test.h"
#include "shapes/hd_proxy.h"

#define CASES 300000u
#define LIFTS_M 1e-7 /* the proxy is lifted by 1 nm above each surface in each iteration */

static const double ORIGIN_M[2] = {0.0, 0.0};

static double uniform(uint64_t *random) {
    return (double)(test_random(random) >> 11) * 0x1p-53;
}

static void press(struct hd_proxy *proxy, double depth_m, double angle) {
    const double normal[2] = {cos(angle), sin(angle)};

    hd_proxy_press(proxy, proxy->plane_count, depth_m, normal);
}

static void project(const struct hd_proxy *proxy, double projected_m[2]) {
    hd_proxy_project(proxy, ORIGIN_M, HD_NO_SLOT, projected_m);
}

/* The broad phase finds only objects within twice the largest depth. */
static void it_is_at_most_twice_the_depth_away(void) {
    uint64_t random = test_run();

    for (uint64_t i = 0; i < test_share(CASES); i++) {
        struct hd_proxy proxy;
        double deepest_m = 0.0;
        double projected_m[2];

        memset(&proxy, 0, sizeof proxy);
        for (size_t planes = 1 + test_below(&random, 5); planes > 0; planes--) {
            const double part = uniform(&random);
            const double depth_m = 0.01 * part * part;

            press(&proxy, depth_m, 2.0 * M_PI * uniform(&random));
            deepest_m = depth_m > deepest_m ? depth_m : deepest_m;
        }
        project(&proxy, projected_m);
        CHECK(hd_distance(projected_m, ORIGIN_M) <= 2.0 * deepest_m + LIFTS_M);
    }
}

/* A probe at depth d below one surface comes to the second one. In a corner of 60 degrees the proxy goes to the edge,
 * d / tan 60 away; in a narrower one it stays. */
static void it_does_not_leap_when_a_second_surface_is_pressed(void) {
    uint64_t random = test_run() + 1000;

    for (uint64_t i = 0; i < test_share(CASES); i++) {
        const double depth_m = 0.01 * uniform(&random);
        const double angle = 2.0 * M_PI * uniform(&random);
        struct hd_proxy proxy;
        double before_m[2];
        double after_m[2];

        memset(&proxy, 0, sizeof proxy);
        press(&proxy, depth_m, angle);
        project(&proxy, before_m);
        press(&proxy, 1e-12, angle + 2.0 * M_PI * uniform(&random));
        project(&proxy, after_m);
        CHECK(hd_distance(before_m, after_m) <= depth_m / tan(M_PI / 3.0) + LIFTS_M);
    }
}

int main(void) {
    it_is_at_most_twice_the_depth_away();
    it_does_not_leap_when_a_second_surface_is_pressed();
    puts("test_proxy: ok");
    return 0;
}
