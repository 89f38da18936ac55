"""The system calls that a sandboxed child may make, and their numbers.

**Conventions.** A group is a table of `name x86_64 aarch64`; `-` if a machine has no such call. The numbers are of the
kernel's headers (`asm/unistd_64.h`, `asm-generic/unistd.h`), up to Linux 6.18. The groups contain the calls traced from
this platform's children over the recordings of the tests. They also contain the calls for memory, threads and time that
the C libraries, numpy, numba, pyarrow and Open3D make on other kernels. To find a refused call that is needed, set the
filter's flag 2 (`SECCOMP_FILTER_FLAG_LOG`): the kernel then logs each refusal with its number.
"""

from collections.abc import Mapping

NEWEST = 469  # file_setattr(2), the last call of Linux 6.18; later calls are unknown here
MACHINES = ("x86_64", "aarch64")

SystemCalls = Mapping[str, Mapping[str, int]]


def _table(words: str) -> SystemCalls:
    """Return the numbers by machine and name."""
    fields = words.split()
    rows = list(zip(fields[::3], fields[1::3], fields[2::3], strict=True))
    return {
        machine: {row[0]: int(row[column]) for row in rows if row[column] != "-"}
        for column, machine in enumerate(MACHINES, start=1)
    }


# Its own memory.
MEMORY = _table(
    """
    brk 12 214  mmap 9 222  munmap 11 215  mremap 25 216  mprotect 10 226  madvise 28 233  mincore 27 232
    msync 26 227  membarrier 324 283  map_shadow_stack 453 453  mseal 462 462
    mbind 237 235  set_mempolicy 238 237  get_mempolicy 239 236
    """
)
# Its own threads, received signals, and reading (not setting) its scheduling.
THREADS = _table(
    """
    futex 202 98  futex_waitv 449 449  set_robust_list 273 99  rseq 334 293  set_tid_address 218 96
    gettid 186 178  exit 60 93  exit_group 231 94  restart_syscall 219 128  arch_prctl 158 -
    sched_yield 24 124  sched_getaffinity 204 123  sched_getparam 143 121  sched_getscheduler 145 120
    sched_get_priority_max 146 125  sched_get_priority_min 147 126  rt_sigaction 13 134  rt_sigprocmask 14 135
    rt_sigreturn 15 139  sigaltstack 131 132  rt_sigpending 127 136  rt_sigsuspend 130 133
    rt_sigtimedwait 128 137  pause 34 -
    """
)
# Its identity, and the time.
ITSELF = _table(
    """
    getpid 39 172  getppid 110 173  getuid 102 174  geteuid 107 175  getgid 104 176  getegid 108 177
    getgroups 115 158  getresuid 118 148  getresgid 120 150  getpgrp 111 -  getpgid 121 155  getsid 124 156
    uname 63 160  sysinfo 99 179  getrusage 98 165  getcpu 309 168  getcwd 79 17  getrlimit 97 163
    umask 95 166  getrandom 318 278  clock_gettime 228 113  clock_getres 229 114  clock_nanosleep 230 115
    nanosleep 35 101  gettimeofday 96 169  time 201 -  times 100 153  getitimer 36 102  setitimer 38 103
    alarm 37 -
    """
)
# Open descriptors, and descriptors made without a path.
DESCRIPTORS = _table(
    """
    read 0 63  readv 19 65  pread64 17 67  preadv 295 69  preadv2 327 286  write 1 64  writev 20 66
    pwrite64 18 68  pwritev 296 70  pwritev2 328 287  lseek 8 62  close 3 57  close_range 436 436  dup 32 23
    dup2 33 -  dup3 292 24  fstat 5 80  fstatfs 138 44  getdents 78 -  getdents64 217 61  fadvise64 221 223
    readahead 187 213  poll 7 -  ppoll 271 73  select 23 -  pselect6 270 72  epoll_create 213 -
    epoll_create1 291 20  epoll_ctl 233 21  epoll_wait 232 -  epoll_pwait 281 22  epoll_pwait2 441 441
    eventfd 284 -  eventfd2 290 19  pipe 22 -  pipe2 293 59
    """
)
# Facts about a path, without its content.
PATHS = _table(
    """
    stat 4 -  lstat 6 -  newfstatat 262 79  statx 332 291  statfs 137 43  access 21 -  faccessat 269 48
    faccessat2 439 439  readlink 89 -  readlinkat 267 78
    """
)
# Creating, moving, removing and flushing files and folders, within the limits of Landlock. Changes of modes, owners,
# times, attributes and, by path, of a file's length are not listed: older versions of Landlock check none of these.
WRITING = _table(
    """
    creat 85 -  mkdir 83 -  mkdirat 258 34  rmdir 84 -  unlink 87 -  unlinkat 263 35  rename 82 -
    renameat 264 38  renameat2 316 276  ftruncate 77 46  fallocate 285 47  fsync 74 82  fdatasync 75 83
    sync_file_range 277 84  sendfile 40 71  copy_file_range 326 285  flock 73 32
    """
)
# Links.
LINKING = _table(
    """
    link 86 -  linkat 265 37  symlink 88 -  symlinkat 266 36
    """
)
# Calls with checked arguments (`seccomp.py`).
JUDGED = _table(
    """
    openat 257 56  open 2 -  fcntl 72 25  ioctl 16 29  prctl 157 167  prlimit64 302 261  clone 56 220
    kill 62 129  tgkill 234 131  tkill 200 130  socketpair 53 199
    """
)
# Calls whose arguments no filter can read: they return ENOSYS, and the C library uses another call.
ABSENT = _table(
    """
    clone3 435 435  openat2 437 437
    """
)
