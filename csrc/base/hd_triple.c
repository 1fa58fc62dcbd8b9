/* The writer's side of the triple buffer. hd_triple.h shows which thread owns which buffer. */
#include "base/hd_triple.h"

void hd_triple_init(struct hd_triple *triple) {
    triple->front = 0;
    hd_atomic_u32_store_relaxed(&triple->middle, 1);
    triple->back = 2;
}

HD_RT void hd_triple_publish(struct hd_triple *triple) {
    triple->back = hd_atomic_u32_exchange_acq_rel(&triple->middle, triple->back | HD_TRIPLE_NEW) & HD_TRIPLE_INDEX;
}
