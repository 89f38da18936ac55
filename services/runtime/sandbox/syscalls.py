"""System call numbers that the sandbox denies, by machine and by effect.

**Conventions.** `NUMBERS[machine][name]`, `machine` as `os.uname().machine` says it; from the kernel's own headers
(`asm/unistd_64.h` for x86_64, `asm-generic/unistd.h` for aarch64, which never had the older calls). A group is names;
a name that a machine does not have is not refused there, since nobody can call it.
"""


def _names(words: str) -> tuple[str, ...]:
    return tuple(words.split())


NETWORK = _names(
    """
    socket connect bind listen accept accept4 sendto sendmsg sendmmsg recvfrom recvmsg recvmmsg
    """
)
PROCESSES = _names(
    """
    fork vfork execve execveat tkill rt_sigqueueinfo rt_tgsigqueueinfo pidfd_open pidfd_send_signal pidfd_getfd
    ptrace process_vm_readv process_vm_writev process_madvise setrlimit shmget shmat msgget semget mq_open
    """
)
MACHINE = _names(
    """
    mount umount2 pivot_root chroot unshare setns move_mount open_tree fsopen fsmount mount_setattr swapon swapoff
    acct quotactl quotactl_fd bpf perf_event_open userfaultfd io_uring_setup io_uring_enter io_uring_register keyctl
    add_key request_key init_module finit_module delete_module kexec_load kexec_file_load reboot syslog personality
    iopl ioperm setuid setgid setreuid setregid setresuid setresgid setgroups setfsuid setfsgid capset sethostname
    setdomainname settimeofday clock_settime adjtimex clock_adjtime name_to_handle_at open_by_handle_at
    fanotify_init
    """
)
OWNERSHIP = _names(
    """
    mknod mknodat chown fchown lchown fchownat setxattr lsetxattr fsetxattr removexattr lremovexattr fremovexattr
    utime utimes utimensat futimesat
    """
)
FILES = _names(
    """
    creat truncate rename renameat renameat2 unlink unlinkat mkdir mkdirat rmdir chmod fchmod fchmodat fchmodat2
    """
)
LINKS = _names("link linkat symlink symlinkat")

_X86_64 = """
    socket 41 socketpair 53 connect 42 bind 49 listen 50 accept 43 accept4 288 sendto 44 sendmsg 46 sendmmsg 307
    recvfrom 45 recvmsg 47 recvmmsg 299 fork 57 vfork 58 clone 56 clone3 435 execve 59 execveat 322 kill 62 tkill 200
    tgkill 234 rt_sigqueueinfo 129 rt_tgsigqueueinfo 297 pidfd_open 434 pidfd_send_signal 424 pidfd_getfd 438 ptrace 101
    process_vm_readv 310 process_vm_writev 311 process_madvise 440 prlimit64 302 setrlimit 160 ioctl 16 open 2
    openat 257 openat2 437 creat 85 truncate 76 rename 82 renameat 264 renameat2 316 link 86 linkat 265 symlink 88
    symlinkat 266 unlink 87 unlinkat 263 mkdir 83 mkdirat 258 rmdir 84 mknod 133 mknodat 259 chmod 90 fchmod 91
    fchmodat 268 fchmodat2 452 chown 92 fchown 93 lchown 94 fchownat 260 setxattr 188 lsetxattr 189 fsetxattr 190
    removexattr 197 lremovexattr 198 fremovexattr 199 utime 132 utimes 235 utimensat 280 futimesat 261
    open_by_handle_at 304 name_to_handle_at 303 mount 165 umount2 166 pivot_root 155 chroot 161 unshare 272 setns 308
    move_mount 429 open_tree 428 fsopen 430 fsmount 432 mount_setattr 442 swapon 167 swapoff 168 acct 163 quotactl 179
    quotactl_fd 443 bpf 321 perf_event_open 298 userfaultfd 323 io_uring_setup 425 io_uring_enter 426
    io_uring_register 427 keyctl 250 add_key 248 request_key 249 init_module 175 finit_module 313 delete_module 176
    kexec_load 246 kexec_file_load 320 reboot 169 syslog 103 personality 135 iopl 172 ioperm 173 setuid 105 setgid 106
    setreuid 113 setregid 114 setresuid 117 setresgid 119 setgroups 116 setfsuid 122 setfsgid 123 capset 126
    sethostname 170 setdomainname 171 settimeofday 164 clock_settime 227 adjtimex 159 clock_adjtime 305 shmget 29
    shmat 30 msgget 68 semget 64 mq_open 240 fanotify_init 300
"""
_AARCH64 = """
    socket 198 socketpair 199 connect 203 bind 200 listen 201 accept 202 accept4 242 sendto 206 sendmsg 211 sendmmsg 269
    recvfrom 207 recvmsg 212 recvmmsg 243 clone 220 clone3 435 execve 221 execveat 281 kill 129 tkill 130 tgkill 131
    rt_sigqueueinfo 138 rt_tgsigqueueinfo 240 pidfd_open 434 pidfd_send_signal 424 pidfd_getfd 438 ptrace 117
    process_vm_readv 270 process_vm_writev 271 process_madvise 440 prlimit64 261 setrlimit 164 ioctl 29 openat 56
    openat2 437 truncate 45 renameat 38 renameat2 276 linkat 37 symlinkat 36 unlinkat 35 mkdirat 34 mknodat 33 fchmod 52
    fchmodat 53 fchmodat2 452 fchown 55 fchownat 54 setxattr 5 lsetxattr 6 fsetxattr 7 removexattr 14 lremovexattr 15
    fremovexattr 16 utimensat 88 open_by_handle_at 265 name_to_handle_at 264 mount 40 umount2 39 pivot_root 41 chroot 51
    unshare 97 setns 268 move_mount 429 open_tree 428 fsopen 430 fsmount 432 mount_setattr 442 swapon 224 swapoff 225
    acct 89 quotactl 60 quotactl_fd 443 bpf 280 perf_event_open 241 userfaultfd 282 io_uring_setup 425
    io_uring_enter 426 io_uring_register 427 keyctl 219 add_key 217 request_key 218 init_module 105 finit_module 273
    delete_module 106 kexec_load 104 kexec_file_load 294 reboot 142 syslog 116 personality 92 setuid 146 setgid 144
    setreuid 145 setregid 143 setresuid 147 setresgid 149 setgroups 159 setfsuid 151 setfsgid 152 capset 91
    sethostname 161 setdomainname 162 settimeofday 170 clock_settime 112 adjtimex 171 clock_adjtime 266 shmget 194
    shmat 196 msgget 186 semget 190 mq_open 180 fanotify_init 262
"""


def _numbers(table: str) -> dict[str, int]:
    words = table.split()
    return {name: int(number) for name, number in zip(words[::2], words[1::2], strict=True)}


NUMBERS = {"x86_64": _numbers(_X86_64), "aarch64": _numbers(_AARCH64)}
