/* Sends one message to many stream sockets in one call, so that a caller in Python releases the interpreter lock once
 * and not for each socket. Control side. */
#include <errno.h>
#include <sys/socket.h>
#include <sys/uio.h>

#include "api/hd_core.h"

static int64_t send_parts(int32_t socket, const struct iovec *parts) {
    struct msghdr message = {0};
    ssize_t taken;

    message.msg_iov = (struct iovec *)(uintptr_t)parts;
    message.msg_iovlen = 2;

    do
        taken = sendmsg(socket, &message, MSG_DONTWAIT | MSG_NOSIGNAL);
    while (taken < 0 && errno == EINTR);
    return taken < 0 ? -(int64_t)errno : (int64_t)taken;
}

void hd_send_each(const int32_t *sockets, size_t count, const void *head, size_t head_size, const void *data,
                  size_t data_size, int64_t *taken) {
    const struct iovec parts[2] = {{(void *)(uintptr_t)head, head_size}, {(void *)(uintptr_t)data, data_size}};

    for (size_t i = 0; i < count; ++i)
        taken[i] = send_parts(sockets[i], parts);
}
