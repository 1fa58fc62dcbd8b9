/* What the guest does while it has nothing to do: passes virtual time.
 *
 * A machine that halts has to be woken by QEMU's main loop for every timer, which takes a good part of a millisecond of
 * the host's time; there are 20000 such wakes in a second of a daemon. Instructions that do nothing pass the same
 * virtual time at 10 ns a block. Runs as SCHED_IDLE, so that everything else goes first; needs no library. */
#include <sys/syscall.h>

#define SCHED_IDLE_POLICY 5

void _start(void) __attribute__((noreturn));

void _start(void) {
    const int priority = 0;
    long result;
    __asm__ volatile("syscall"
                     : "=a"(result)
                     : "a"(SYS_sched_setscheduler), "D"(0), "S"(SCHED_IDLE_POLICY), "d"(&priority)
                     : "rcx", "r11", "memory");
    for (;;) {
        __asm__ volatile(".rept 256\n\tnop\n\t.endr");
    }
}
