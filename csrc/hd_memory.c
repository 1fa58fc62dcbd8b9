/* See hd_memory.h. MCL_ONFAULT matters: without it a Python process locks three times the memory that it uses. */
#include "hd_memory.h"

#include <errno.h>
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

enum hd_memory_kind hd_memory_lock(const struct hd_region *regions, size_t count, int *error) {
    *error = 0;
    if (mlockall(MCL_CURRENT | MCL_FUTURE | MCL_ONFAULT) == 0) {
        return HD_MEMORY_PROCESS;
    }
    *error = errno;
    for (size_t i = 0; i < count; i++) {
        if (mlock(regions[i].start, regions[i].size) != 0) {
            *error = errno;
            for (size_t done = 0; done < i; done++) {
                munlock(regions[done].start, regions[done].size);
            }
            return HD_MEMORY_NONE;
        }
    }
    return HD_MEMORY_REGIONS;
}
