/* The last thing that a process does which ends by a fault of its own: it takes the device's force to zero. Control
 * sets it up (hd_api.h); the writer of a device asks whether it is still its turn. */
#ifndef HD_LAST_REPORT_REPORT_H
#define HD_LAST_REPORT_REPORT_H

#include <signal.h>

/* 1: the process is ending, and nobody but the handler writes to the device any more. Any thread. */
int hd_last_report_is_over(void);
/* Takes the signals of a fault out of those that a thread is to block: a fault where its signal is blocked ends the
 * process without the handler. */
void hd_last_report_let_through(sigset_t *blocked);

#endif
