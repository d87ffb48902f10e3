/* Preloaded into a test's process: counts whatever changes a folder, and at one of these changes ends the process or fails.

   crash_arm(folder, number, mode, store): before the change `number` (from 1) below `folder`, in this process or one forked from it,
   mode 0 nothing, 1 end at once (no handler, no flush), 2 this change fails with EIO, 3 this and all later ones fail with ENOSPC.
   crash_watch(asked, granted): before every change a byte goes into the pipe `asked`, and the change waits for one of `granted`.
   crash_apart(): count apart from the process that this one was forked from.
   store: a folder that receives what an fsync makes durable: `f-INODE` a file's content, `d-INODE` a folder's entries, one a line as
   KIND INODE NAME[\tTARGET]; empty: none is kept. */
#define _GNU_SOURCE
#include <dirent.h>
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/sendfile.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <sys/uio.h>
#include <unistd.h>

static char folder[PATH_MAX], store[PATH_MAX];
static size_t length;
static long at;
static int mode, asked = -1, granted = -1;
static long *count;

#define NEXT(type, name) static __typeof__(type) *name##_; if (!name##_) name##_ = dlsym(RTLD_NEXT, #name)

void crash_arm(const char *root, long number, int how, const char *durable) {
  if (!count) count = mmap(0, 4096, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0);
  *count = 0;
  strncpy(folder, root, PATH_MAX - 1);
  strncpy(store, durable, PATH_MAX - 1);
  length = strlen(folder);
  at = number;
  mode = how;
}
long crash_count(void) { return count ? *count : 0; }
void crash_disarm(void) { length = 0; asked = -1; }
void crash_watch(int ask, int grant) { asked = ask; granted = grant; }
void crash_apart(void) { count = 0; }

static int below(int base, const char *path) {
  char whole[2 * PATH_MAX], link[64];
  ssize_t n = 0;
  if (!length || !path) return 0;
  if (path[0] != '/') {
    if (base == AT_FDCWD) {
      if (!getcwd(whole, PATH_MAX)) return 0;
      n = strlen(whole);
    } else {
      snprintf(link, sizeof link, "/proc/self/fd/%d", base);
      n = readlink(link, whole, PATH_MAX - 1);
      if (n < 0) return 0;
    }
    whole[n++] = '/';
  }
  snprintf(whole + n, sizeof whole - n, "%s", path);
  return !strncmp(whole, folder, length) && (whole[length] == '/' || !whole[length]);
}
static int of_handle(int fd) {
  char link[64], whole[PATH_MAX];
  if (!length || fd < 0) return 0;
  snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
  ssize_t n = readlink(link, whole, PATH_MAX - 1);
  if (n < 0) return 0;
  whole[n] = 0;
  return below(AT_FDCWD, whole);
}

/* What a program gives to a buffered stream, in words of a few bytes as OpenEXR does, comes to the disk a buffer at a time. */
static __thread FILE *filled;
static __thread size_t held;

/* The change is about to happen: 0 to go on, -1 (with errno) to fail. `grows`: a full disk refuses it. */
static int change(int grows) {
  long n = __atomic_add_fetch(count, 1, __ATOMIC_SEQ_CST);
  char byte = 0;
  filled = 0;
  if (asked >= 0 && syscall(SYS_write, asked, &byte, 1) == 1) while (syscall(SYS_read, granted, &byte, 1) < 0 && errno == EINTR) {}
  if (n == at && mode == 1) syscall(SYS_exit_group, 137);
  if (n == at && mode == 2) { errno = EIO; return -1; }
  if (n >= at && mode == 3 && grows) { errno = ENOSPC; return -1; }
  return 0;
}

static void keep(int fd) {
  struct stat s;
  char path[2 * PATH_MAX], aside[2 * PATH_MAX + 32], buffer[1 << 16];
  if (!store[0] || fstat(fd, &s)) return;
  snprintf(path, sizeof path, "%s/%c-%lu", store, S_ISDIR(s.st_mode) ? 'd' : 'f', (unsigned long)s.st_ino);
  snprintf(aside, sizeof aside, "%s.%ld", path, (long)syscall(SYS_gettid));
  int out = syscall(SYS_openat, AT_FDCWD, aside, O_WRONLY | O_CREAT | O_TRUNC, 0666);
  if (out < 0) return;
  snprintf(buffer, sizeof buffer, "/proc/self/fd/%d", fd);
  if (S_ISDIR(s.st_mode)) {
    DIR *d = opendir(buffer);
    for (struct dirent *e; d && (e = readdir(d));) {
      struct stat t;
      char line[3 * PATH_MAX], target[PATH_MAX] = "";
      if (!strcmp(e->d_name, ".") || !strcmp(e->d_name, "..") || fstatat(dirfd(d), e->d_name, &t, AT_SYMLINK_NOFOLLOW)) continue;
      if (S_ISLNK(t.st_mode)) target[readlinkat(dirfd(d), e->d_name, target, PATH_MAX - 1)] = 0;
      int n = snprintf(line, sizeof line, "%c %lu %s\t%s\n", S_ISDIR(t.st_mode) ? 'd' : S_ISLNK(t.st_mode) ? 'l' : 'f',
                       (unsigned long)t.st_ino, e->d_name, target);
      syscall(SYS_write, out, line, n);
    }
    if (d) closedir(d);
  } else {
    int in = syscall(SYS_openat, AT_FDCWD, buffer, O_RDONLY, 0);
    for (ssize_t n; in >= 0 && (n = read(in, buffer, sizeof buffer)) > 0;) syscall(SYS_write, out, buffer, n);
    if (in >= 0) syscall(SYS_close, in);
  }
  syscall(SYS_close, out);
  syscall(SYS_renameat, AT_FDCWD, aside, AT_FDCWD, path);  /* one who looks meanwhile finds what was durable before, or this */
}

#define WRITES(flags) ((flags) & (O_WRONLY | O_RDWR | O_CREAT | O_TRUNC))
#define OPEN(name)                                                                        \
  int name(const char *path, int flags, ...) {                                            \
    NEXT(int(const char *, int, ...), name);                                          \
    va_list list; va_start(list, flags); mode_t bits = va_arg(list, mode_t); va_end(list);  \
    if (WRITES(flags) && below(AT_FDCWD, path) && change(1)) return -1;                   \
    return name##_(path, flags, bits);                                                    \
  }
OPEN(open) OPEN(open64)
#define OPENAT(name)                                                                      \
  int name(int base, const char *path, int flags, ...) {                                  \
    NEXT(int(int, const char *, int, ...), name);                                     \
    va_list list; va_start(list, flags); mode_t bits = va_arg(list, mode_t); va_end(list);  \
    if (WRITES(flags) && below(base, path) && change(1)) return -1;                       \
    return name##_(base, path, flags, bits);                                              \
  }
OPENAT(openat) OPENAT(openat64)
#define FOPEN(name)                                                                       \
  FILE *name(const char *path, const char *how) {                                         \
    NEXT(FILE *(const char *, const char *), name);                                    \
    if (strpbrk(how, "wa+") && below(AT_FDCWD, path) && change(1)) return NULL;           \
    return name##_(path, how);                                                            \
  }
FOPEN(fopen) FOPEN(fopen64)
#define ON_HANDLE(type, name, types, ...)                                                 \
  type name types {                                                                       \
    NEXT(type types, name);                                                           \
    if (of_handle(fd) && change(1)) return -1;                                            \
    return name##_(__VA_ARGS__);                                                          \
  }
ON_HANDLE(ssize_t, write, (int fd, const void *data, size_t n), fd, data, n)
ON_HANDLE(ssize_t, pwrite, (int fd, const void *data, size_t n, off_t o), fd, data, n, o)
ON_HANDLE(ssize_t, pwrite64, (int fd, const void *data, size_t n, off_t o), fd, data, n, o)
ON_HANDLE(ssize_t, writev, (int fd, const struct iovec *v, int n), fd, v, n)
ON_HANDLE(int, ftruncate, (int fd, off_t n), fd, n)
ON_HANDLE(int, ftruncate64, (int fd, off_t n), fd, n)
ON_HANDLE(ssize_t, sendfile, (int fd, int in, off_t *o, size_t n), fd, in, o, n)
ON_HANDLE(ssize_t, sendfile64, (int fd, int in, off_t *o, size_t n), fd, in, o, n)
ON_HANDLE(ssize_t, copy_file_range, (int in, off_t *a, int fd, off_t *b, size_t n, unsigned f), in, a, fd, b, n, f)
ON_HANDLE(ssize_t, pwritev, (int fd, const struct iovec *v, int n, off_t o), fd, v, n, o)
ON_HANDLE(int, fallocate, (int fd, int f, off_t o, off_t n), fd, f, o, n)
size_t fwrite(const void *data, size_t size, size_t n, FILE *stream) {
  NEXT(size_t(const void *, size_t, size_t, FILE *), fwrite);
  if (length && of_handle(fileno(stream))) {
    if (filled != stream || held + size * n > 4096) {
      if (change(1)) return 0;
      filled = stream;
      held = 0;
    }
    held += size * n;
  }
  return fwrite_(data, size, n, stream);
}
#define SYNC(name)                                                                        \
  int name(int fd) {                                                                      \
    NEXT(int(int), name);                                                             \
    int ours = of_handle(fd);                                                             \
    if (ours && change(1)) return -1;                                                     \
    if (ours) keep(fd);                                                                   \
    return name##_(fd);                                                                   \
  }
SYNC(fsync) SYNC(fdatasync)
#define ON_PATH(name, grows, base, path, types, ...)                                      \
  int name types {                                                                        \
    NEXT(int types, name);                                                            \
    if (below(base, path) && change(grows)) return -1;                                    \
    return name##_(__VA_ARGS__);                                                          \
  }
ON_PATH(rename, 1, AT_FDCWD, to, (const char *from, const char *to), from, to)
ON_PATH(renameat, 1, b, to, (int a, const char *from, int b, const char *to), a, from, b, to)
ON_PATH(renameat2, 1, b, to, (int a, const char *from, int b, const char *to, unsigned f), a, from, b, to, f)
ON_PATH(link, 1, AT_FDCWD, to, (const char *from, const char *to), from, to)
ON_PATH(linkat, 1, b, to, (int a, const char *from, int b, const char *to, int f), a, from, b, to, f)
ON_PATH(symlink, 1, AT_FDCWD, to, (const char *from, const char *to), from, to)
ON_PATH(symlinkat, 1, b, to, (const char *from, int b, const char *to), from, b, to)
ON_PATH(mkdir, 1, AT_FDCWD, path, (const char *path, mode_t bits), path, bits)
ON_PATH(mkdirat, 1, b, path, (int b, const char *path, mode_t bits), b, path, bits)
ON_PATH(unlink, 0, AT_FDCWD, path, (const char *path), path)
ON_PATH(unlinkat, 0, b, path, (int b, const char *path, int f), b, path, f)
ON_PATH(remove, 0, AT_FDCWD, path, (const char *path), path)
ON_PATH(rmdir, 0, AT_FDCWD, path, (const char *path), path)
ON_PATH(truncate, 1, AT_FDCWD, path, (const char *path, off_t n), path, n)
