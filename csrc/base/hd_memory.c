/* Touches and locks memory, so that the servo never waits for a page fault. MCL_ONFAULT matters: without it a Python
 * process locks three times the memory that it uses. */
#include "base/hd_memory.h"

#include "api/hd_core.h"

#include <errno.h>
#include <limits.h>
#include <malloc.h>
#include <stdint.h>
#include <sys/mman.h>
#include <unistd.h>

void hd_memory_touch(const struct hd_region *regions, size_t count) {
    const long page = sysconf(_SC_PAGESIZE);
    const size_t step = page > 0 ? (size_t)page : 4096u;
    for (size_t i = 0; i < count; i++) {
        volatile unsigned char *bytes = regions[i].start;
        for (size_t at = 0; at < regions[i].size; at += step) {
            bytes[at] = bytes[at];
        }
        if (regions[i].size > 0) {
            bytes[regions[i].size - 1] = bytes[regions[i].size - 1];
        }
    }
}

int hd_memory_lock_regions(const struct hd_region *regions, size_t count) {
    for (size_t i = 0; i < count; i++) {
        if (regions[i].size > 0 && mlock(regions[i].start, regions[i].size) != 0) {
            return errno;
        }
    }
    return 0;
}

enum hd_memory_kind hd_memory_lock(const struct hd_region *regions, size_t count, int *error) {
    *error = 0;
    if (mlockall(MCL_CURRENT | MCL_FUTURE | MCL_ONFAULT) == 0) {
        return HD_MEMORY_PROCESS;
    }
    *error = errno;
    const int refused = hd_memory_lock_regions(regions, count);
    if (refused == 0) {
        return HD_MEMORY_REGIONS;
    }
    *error = refused;
    for (size_t i = 0; i < count; i++) {
        munlock(regions[i].start, regions[i].size);
    }
    return HD_MEMORY_NONE;
}

int hd_memory_large_from(size_t bytes) {
#ifdef __GLIBC__
    /* Unless the limit is set, glibc raises it to the largest such block that was freed, up to 32 MiB. */
    if (bytes > INT_MAX || mallopt(M_MMAP_THRESHOLD, (int)bytes) == 0) {
        return hd_invalid("memory: malloc cannot map blocks of %zu bytes or more separately: too large", bytes);
    }
#else
    (void)bytes; /* other C libraries do not raise their limit */
#endif
    return HD_OK;
}
