/* Tables that the servo owns: copies of what Python compiled, in memory that grows on the control side only. */
#ifndef HD_TABLE_H
#define HD_TABLE_H

#include "hd_core.h"

struct hd_table_buffer {
    struct hd_table table;
    uint32_t wall_capacity;
    uint32_t membrane_capacity;
};

/* Copies `source`, which must have passed hd_table_check. HD_ERR_MEMORY leaves the buffer as it was. Control side. */
int hd_table_copy(struct hd_table_buffer *buffer, const struct hd_table *source);
void hd_table_release(struct hd_table_buffer *buffer);
/* Checks one mode, as a table's or a command's. */
int hd_mode_check(const struct hd_mode *mode, const char *what);

#endif
