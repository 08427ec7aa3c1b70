/* A ptrace for user-mode-linux 6.1 on processors with AMX, to be preloaded.
 *
 * Linux takes the extended registers of another process whole or not at all. This kernel keeps the first 2.7 kB of
 * them; with AMX there are 11 kB, so it panics: "ptrace set fp regs failed, errno = 14". Here what it leaves out
 * stays as it is in the process.
 */
#define _GNU_SOURCE
#include <elf.h>
#include <stdarg.h>
#include <string.h>
#include <sys/ptrace.h>
#include <sys/syscall.h>
#include <sys/uio.h>
#include <unistd.h>

long ptrace(enum __ptrace_request request, ...)
{
    va_list rest;
    va_start(rest, request);
    pid_t pid = va_arg(rest, pid_t);
    void *address = va_arg(rest, void *);
    void *data = va_arg(rest, void *);
    va_end(rest);

    if (request == PTRACE_PEEKTEXT || request == PTRACE_PEEKDATA || request == PTRACE_PEEKUSER) {
        long word = 0; /* glibc returns what the system call writes */
        return syscall(SYS_ptrace, request, pid, address, &word) < 0 ? -1 : word;
    }
    if (request == PTRACE_SETREGSET && address == (void *)NT_X86_XSTATE) {
        static char registers[1 << 16];
        struct iovec *given = data, whole = {registers, sizeof registers};
        if (syscall(SYS_ptrace, PTRACE_GETREGSET, pid, address, &whole) == 0 && given->iov_len < whole.iov_len) {
            memcpy(registers, given->iov_base, given->iov_len);
            return syscall(SYS_ptrace, request, pid, address, &whole);
        }
    }
    return syscall(SYS_ptrace, request, pid, address, data);
}
