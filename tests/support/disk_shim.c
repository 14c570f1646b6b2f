/* SPDX-License-Identifier: Apache-2.0 */
/* Errors of the disk on demand, for tests: LD_PRELOAD this into a process.

   FAULT_FOLDER names the folder whose files fail; FAULT_CONTROL names a file of six 32-bit numbers
   that a test writes: the errno with which to fail, or 0, for writing, creating, syncing, renaming
   and asking for room; the sixth one is a share of calls that fail, in thousandths. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <sys/statvfs.h>
#include <sys/uio.h>
#include <unistd.h>

enum { WRITE, CREATE, SYNC, RENAME, ROOM, SHARE, NUMBERS };

static volatile int32_t *control(void)
{
    static volatile int32_t *numbers;
    static const int32_t none[NUMBERS];
    if (numbers)
        return numbers;
    numbers = (volatile int32_t *)none;
    const char *path = getenv("FAULT_CONTROL");
    int (*real)(const char *, int, ...) = dlsym(RTLD_NEXT, "open");
    int fd = path ? real(path, O_RDONLY) : -1;
    if (fd < 0)
        return numbers;
    void *mapped = mmap(NULL, NUMBERS * sizeof(int32_t), PROT_READ, MAP_SHARED, fd, 0);
    if (mapped != MAP_FAILED)
        numbers = mapped;
    close(fd);
    return numbers;
}

static int in_folder(const char *path)
{
    const char *folder = getenv("FAULT_FOLDER");
    return folder && path && strncmp(path, folder, strlen(folder)) == 0;
}

static int fails(int what, int inside)
{
    volatile int32_t *numbers = control();
    static unsigned seed = 1;
    if (!numbers[what] || !inside)
        return 0;
    if (numbers[SHARE] && rand_r(&seed) % 1000 >= numbers[SHARE])
        return 0;
    errno = numbers[what];
    return 1;
}

static int fd_in_folder(int fd)
{
    char link[64], path[4096];
    snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
    ssize_t size = readlink(link, path, sizeof path - 1);
    if (size < 0)
        return 0;
    path[size] = 0;
    return in_folder(path);
}

#define REAL(name) static __typeof__(name) *real; if (!real) real = dlsym(RTLD_NEXT, #name)

ssize_t write(int fd, const void *data, size_t size)
{
    REAL(write);
    if (control()[WRITE] && fails(WRITE, fd_in_folder(fd)))
        return -1;
    return real(fd, data, size);
}

ssize_t writev(int fd, const struct iovec *parts, int count)
{
    REAL(writev);
    if (control()[WRITE] && fails(WRITE, fd_in_folder(fd)))
        return -1;
    return real(fd, parts, count);
}

int fsync(int fd)
{
    REAL(fsync);
    if (control()[SYNC] && fails(SYNC, fd_in_folder(fd)))
        return -1;
    return real(fd);
}

#define OPEN(name) \
    int name(const char *path, int flags, ...) \
    { \
        REAL(name); \
        va_list rest; \
        va_start(rest, flags); \
        mode_t mode = va_arg(rest, int); \
        va_end(rest); \
        if ((flags & O_CREAT) && fails(CREATE, in_folder(path))) \
            return -1; \
        return real(path, flags, mode); \
    }
OPEN(open)
OPEN(open64)

int mkdir(const char *path, mode_t mode)
{
    REAL(mkdir);
    return fails(CREATE, in_folder(path)) ? -1 : real(path, mode);
}

int rename(const char *from, const char *to)
{
    REAL(rename);
    return fails(RENAME, in_folder(to)) ? -1 : real(from, to);
}

int statvfs(const char *path, struct statvfs *found)
{
    REAL(statvfs);
    return fails(ROOM, in_folder(path)) ? -1 : real(path, found);
}

int statvfs64(const char *path, struct statvfs64 *found)
{
    REAL(statvfs64);
    return fails(ROOM, in_folder(path)) ? -1 : real(path, found);
}
