/* A file system that refuses a system call: REFUSED_CALL with REFUSED_ERRNO, for paths that contain REFUSED_PATH.
 * "fsync_folder" is an fsync of a folder, and "rename_into" a rename into a folder from outside it.
 * cc -shared -fPIC -o refusing.so refusing_file_system.c -ldl, then LD_PRELOAD=./refusing.so */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <limits.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

static int refused(const char *call, const char *path) {
    const char *chosen = getenv("REFUSED_CALL"), *part = getenv("REFUSED_PATH"), *number = getenv("REFUSED_ERRNO");
    if (!chosen || !part || !number || strcmp(chosen, call) || !strstr(path, part)) return 0;
    errno = atoi(number);
    return 1;
}

static int refused_file(const char *call, int file) {
    char link[64], path[PATH_MAX];
    snprintf(link, sizeof link, "/proc/self/fd/%d", file);
    ssize_t length = readlink(link, path, sizeof path - 1);
    if (length < 0) return 0;
    path[length] = 0;
    return refused(call, path);
}

#define REAL(name, ...) ((int (*)(__VA_ARGS__))dlsym(RTLD_NEXT, #name))

int flock(int file, int operation) { return refused_file("flock", file) ? -1 : REAL(flock, int, int)(file, operation); }

int fsync(int file) {
    struct stat found;
    const char *call = !fstat(file, &found) && S_ISDIR(found.st_mode) ? "fsync_folder" : "fsync";
    return refused_file(call, file) ? -1 : REAL(fsync, int)(file);
}

int rename(const char *from, const char *to) {
    size_t folder = strrchr(to, '/') - to + 1;
    if (refused("rename", to) || (strncmp(from, to, folder) && refused("rename_into", to))) return -1;
    return REAL(rename, const char *, const char *)(from, to);
}

int mkdir(const char *path, mode_t mode) {
    return refused("mkdir", path) ? -1 : REAL(mkdir, const char *, mode_t)(path, mode);
}

int unlink(const char *path) { return refused("unlink", path) ? -1 : REAL(unlink, const char *)(path); }

int rmdir(const char *path) { return refused("rmdir", path) ? -1 : REAL(rmdir, const char *)(path); }

ssize_t write(int file, const void *data, size_t length) {
    return refused_file("write", file) ? -1 : ((ssize_t(*)(int, const void *, size_t))dlsym(RTLD_NEXT, "write"))(file, data, length);
}

ssize_t read(int file, void *data, size_t length) {
    return refused_file("read", file) ? -1 : ((ssize_t(*)(int, void *, size_t))dlsym(RTLD_NEXT, "read"))(file, data, length);
}
