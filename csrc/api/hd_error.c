/* The reason of the last failed check: one line per thread, so that several threads can check at the same time. Never
 * called from the servo thread, because it formats text. */
#include <stdarg.h>
#include <stdio.h>

#include "api/hd_core.h"

static _Thread_local char reason[256];

int hd_invalid(const char *format, ...) {
    va_list arguments;

    va_start(arguments, format);
    if (vsnprintf(reason, sizeof reason, format, arguments) < 0)
        reason[0] = '\0';
    va_end(arguments);
    return HD_ERR_INVALID;
}

const char *hd_invalid_reason(void) {
    return reason;
}
