/* The last reports of a process that crashes: they set the device's force to zero. Control sets them up (hd_api.h); the
 * writer of a device checks whether it may still write. */
#ifndef HD_LAST_REPORT_H
#define HD_LAST_REPORT_H

#include <signal.h>

/* Returns 1 if the process is crashing, so that only the handler may write to the device. Any thread. */
int hd_last_report_is_over(void);
/* Removes the signals of a crash from those that a thread will block, because a crash whose signal is blocked ends the
 * process without calling the handler. */
void hd_last_report_let_through(sigset_t *blocked);

#endif
