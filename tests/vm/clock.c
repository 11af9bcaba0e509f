/* Inside the rig PC: sends its monotonic clock (ns, 8 bytes) each millisecond to the outside, with priority over everything
   else. With `guest_clock_spins` on the kernel's command line it keeps the processor from ever being idle: under
   `-icount` time then is the number of instructions, however little of the real machine's time QEMU gets. */
#define _GNU_SOURCE
#include <fcntl.h>
#include <sched.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#define PERIOD_NS 1000000

static int spins(void) {
    char line[4096] = "";
    FILE *file = fopen("/proc/cmdline", "r");
    if (file && !fgets(line, sizeof line, file)) line[0] = 0;
    return strstr(line, "guest_clock_spins") != NULL;
}

int main(void) {
    if (spins() && fork() == 0) {
        sched_setscheduler(0, SCHED_IDLE, &(struct sched_param){0});
        for (;;) __asm__ volatile(".rept 60\n nop\n .endr"); /* longer blocks are interpreted faster */
    }
    int port;
    while ((port = open("/dev/virtio-ports/clock", O_WRONLY)) < 0) usleep(100000);
    sched_setscheduler(0, SCHED_FIFO, &(struct sched_param){98});
    struct timespec next;
    clock_gettime(CLOCK_MONOTONIC, &next);
    for (;;) {
        struct timespec now;
        clock_gettime(CLOCK_MONOTONIC, &now);
        int64_t ns = now.tv_sec * 1000000000LL + now.tv_nsec;
        if (write(port, &ns, sizeof ns) < 0) usleep(1000);
        int64_t due = next.tv_sec * 1000000000LL + next.tv_nsec + PERIOD_NS;
        if (due < ns) due = ns;
        next = (struct timespec){due / 1000000000LL, due % 1000000000LL};
        clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &next, 0);
    }
}
