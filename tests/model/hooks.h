/* Who tells tests/model/hooks.c what to print of the accesses to memory that the compiler tells it of. */
#ifndef HOOKS_H
#define HOOKS_H

#include <stddef.h>

/* The two sides, and whose a place in memory is: of one's own index a relaxed load is no step, as it says nothing new.
 */
enum trace_side { TRACE_NOBODY, TRACE_WRITER, TRACE_READER, TRACE_BOTH };

void trace_name(const void *start, size_t size, const char *name, enum trace_side owner);
void trace_unname(const void *start);
void trace_begin(const char *call, enum trace_side side);
void trace_end(void);

/* In place of the C library's, which the compiler says nothing of. */
void *traced_memcpy(void *to, const void *from, size_t size);
void *traced_memset(void *to, int value, size_t size);

#endif
