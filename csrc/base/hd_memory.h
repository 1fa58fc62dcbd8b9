/* Memory that causes no page faults in the servo: touched before the servo starts, and locked as far as the limit
 * allows. Control side. */
#ifndef HD_MEMORY_H
#define HD_MEMORY_H

#include <stddef.h>

struct hd_region {
    void *start;
    size_t size;
};

enum hd_memory_kind { HD_MEMORY_NONE = 0, HD_MEMORY_REGIONS = 1, HD_MEMORY_PROCESS = 2 };

/* Makes every page of the regions present and writable; the contents are unchanged. */
void hd_memory_touch(const struct hd_region *regions, size_t count);
/* Locks all pages of the process when they are first touched or, if that is refused, the regions. Returns what was
 * locked; *error is the errno of the last refusal, 0 if nothing was refused. */
enum hd_memory_kind hd_memory_lock(const struct hd_region *regions, size_t count, int *error);
/* Locks more regions. Returns 0 or the errno of the first refused region; those before it stay locked. */
int hd_memory_lock_regions(const struct hd_region *regions, size_t count);

#endif
