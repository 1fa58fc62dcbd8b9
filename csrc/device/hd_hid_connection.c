/* The end of a HID connection, shared by its threads and control: ends it, frees it, notifies control. */
#include "device/hd_hid_connection.h"

#include <errno.h>
#include <stdlib.h>
#include <unistd.h>

void hd_hid_signal(int fd) {
    const uint64_t one = 1;
    /* The write fails only if the count is at its maximum, and then the descriptor is readable anyway. */
    while (write(fd, &one, sizeof one) < 0 && errno == EINTR) {
    }
}

void hd_hid_suspect(struct hd_hid *hid) {
    hd_atomic_u32_store_release(&hid->reset, 1);
    hd_hid_signal(hid->event_fd);
}

void hd_connection_fail(struct hd_connection *connection, int error) {
    struct hd_hid *hid = connection->hid;
    if (hd_atomic_u32_replace(&connection->end, HD_END_NOT, HD_END_FAILED)) {
        hd_atomic_u32_store_relaxed(&hid->error, (uint32_t)error);
        hd_atomic_u32_store_release(&hid->connected, 0);
        hd_hid_signal(connection->end_fd);
        hd_hid_signal(hid->event_fd);
    }
}

void hd_connection_free(struct hd_connection *connection) {
    const int fds[3] = {connection->fd, connection->end_fd, connection->left_fd};
    for (int i = 0; i < 3; i++) {
        if (fds[i] >= 0) {
            close(fds[i]);
        }
    }
    free(connection);
}
