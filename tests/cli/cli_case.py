"""What the command line tests share: running the program, and files to run it on."""
import collections
import contextlib
import json
import os
import resource
import shutil
import subprocess
import tempfile
import unittest
import zlib

import numpy as np

BINARY = None  # set by test_cli.py
MAKE_FIXTURES = None
Result = collections.namedtuple("Result", "code out err")
_fixtures = None


def run(*args, **options):
    """Runs the program with these arguments; nothing that it prints is lost."""
    done = subprocess.run([BINARY, *map(str, args)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, timeout=300,
                          stdin=subprocess.DEVNULL, **options)
    return Result(done.returncode, done.stdout.decode(), done.stderr.decode())


def fixtures():
    """The folder of make_fixtures, made once."""
    global _fixtures
    if _fixtures is None:
        _fixtures = tempfile.TemporaryDirectory(prefix="vdb_nns_fixtures_")
        subprocess.run([MAKE_FIXTURES, _fixtures.name], check=True)
    return _fixtures.name


def watched(**variables):
    """The environment of a program whose system calls are watched: see watch_calls.cpp."""
    library = os.path.join(os.path.dirname(os.path.abspath(MAKE_FIXTURES)), "libvdb_nns_watch_calls.so")
    return dict(os.environ, LD_PRELOAD=library, **variables)


def host_mark():
    """What stands for this host in the names of temporary files."""
    return f"{zlib.crc32(os.uname().nodename.encode()):x}"


def limit_file_size(size):
    """For preexec_fn: files cannot grow past `size` bytes."""
    return lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))


def limit_address_space(size):
    """For preexec_fn: the process maps no more than `size` bytes."""
    return lambda: resource.setrlimit(resource.RLIMIT_AS, (size, size))


@contextlib.contextmanager
def memory_group(limit):
    """A control group of `limit` bytes below that of this process; gives what preexec_fn has to call to enter it. Skips
    the test where none can be made."""
    with open("/proc/self/cgroup") as file:
        groups = [line.strip().split(":", 2) for line in file]
    choices = [("/sys/fs/cgroup/memory" + group, "memory.limit_in_bytes")
               for _, controllers, group in groups if "memory" in controllers.split(",")]
    choices += [("/sys/fs/cgroup" + group, "memory.max") for _, controllers, group in groups if not controllers]
    for parent, limit_name in choices:
        folder = os.path.join(parent, f"vdb_nns_{os.getpid()}_{limit >> 20}")
        try:
            os.mkdir(folder)
        except OSError:
            continue
        try:
            with open(os.path.join(folder, limit_name), "r+") as file:
                file.write(str(limit))
        except OSError:  # a group without the memory controller
            os.rmdir(folder)
            continue

        def enter():
            with open(os.path.join(folder, "cgroup.procs"), "w") as file:
                file.write(str(os.getpid()))
        try:
            yield enter
        finally:
            os.rmdir(folder)
        return
    raise unittest.SkipTest("no control group with a memory limit can be made here")


class CliCase(unittest.TestCase):
    def setUp(self):
        self.folder = tempfile.mkdtemp(prefix="vdb_nns_cli_")
        self.addCleanup(shutil.rmtree, self.folder, ignore_errors=True)

    def path(self, name):
        return os.path.join(self.folder, name)

    def fixture(self, name):
        return os.path.join(fixtures(), name)

    def data(self, name):
        """A file that is kept with the tests, as another program wrote it."""
        return os.path.join(os.path.dirname(os.path.abspath(__file__)), "..", "data", name)

    def npy(self, name, positions, dtype=np.float32):
        np.save(self.path(name), np.asarray(positions, dtype=dtype))
        return self.path(name)

    def text(self, name, content):
        with open(self.path(name), "w" if isinstance(content, str) else "wb") as file:
            file.write(content)
        return self.path(name)

    def bytes(self, path):
        with open(path, "rb") as file:
            return file.read()

    def scene(self, name="block", count=2000, *more):
        path = self.path(name + ".vdb")
        self.succeeds("scene", name, "-n", count, "-o", path, "-q", *more)
        return path

    def succeeds(self, *args, **options):
        done = run(*args, **options)
        self.assertEqual(done.code, 0, f"{args}\n{done.out}\n{done.err}")
        self.assertNotIn("error", done.err)
        return done

    def report(self, *args, **options):
        """The JSON report of a command: all of its stdout."""
        return json.loads(self.succeeds(*args, "--json", "-", **options).out)

    def fails(self, code, *args, says=(), **options):
        """Exit code, one clear error on stderr, nothing on stdout, and not a file more or less than before."""
        before = sorted(os.listdir(self.folder))
        done = run(*args, **options)
        self.assertEqual(done.code, code, f"{args}\n{done.out}\n{done.err}")
        self.assertEqual(done.out, "")
        errors = [line for line in done.err.splitlines() if line.startswith("vdb_nns: error: ")]
        self.assertEqual(len(errors), 1, done.err)
        for word in [says] if isinstance(says, str) else says:
            self.assertIn(word, errors[0])
        self.assertEqual(sorted(os.listdir(self.folder)), before)
        return done
