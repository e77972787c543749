"""Signals: the exit code says which, and no file is left behind; what is left when nothing can be done goes with the next
run."""
import os
import signal
import subprocess
import time

import cli_case
from cli_case import CliCase


class Interrupt(CliCase):
    def stop(self, number, code, at_percent, *args):
        """Sends a signal once the progress has passed a percentage."""
        before = sorted(os.listdir(self.folder))
        with self.start(at_percent, *args) as process:
            start = time.monotonic()
            process.send_signal(number)
            rest = process.stderr.read()
            self.assertEqual(process.stdout.read(), "")
            process.wait()
        self.assertEqual(process.returncode, code, rest)
        self.assertLess(time.monotonic() - start, 10)
        self.assertIn(signal.Signals(number).name, rest)
        self.assertNotIn("PROGRESS 100%", rest)
        self.assertEqual(sorted(os.listdir(self.folder)), before)

    def start(self, at_percent, *args, **options):
        """The program, once its progress has passed a percentage."""
        process = subprocess.Popen([cli_case.BINARY, *args, "--progress", "always"], stdout=subprocess.PIPE,
                                   stderr=subprocess.PIPE, text=True, **options)
        for line in process.stderr:
            if line.startswith("PROGRESS") and int(line[9:-2]) >= at_percent:
                break
        return process

    def test_while_searching(self):
        path = self.scene("block", 100000)
        args = ["search", path, "-o", self.path("x.npz"), "--json", self.path("x.json"), "--repeat", "2000"]
        self.stop(signal.SIGINT, 130, 21, *args)
        self.stop(signal.SIGTERM, 143, 21, *args)
        self.stop(signal.SIGHUP, 129, 21, *args)

    def long_writing(self):
        """A search whose rows take far longer to write than a signal to arrive: about 180 neighbors a particle. They are
        counted first, up to 53 % of its progress, and then written as they are found."""
        path = self.scene("block", 100000)
        radius = repr(3.5 * self.report("info", path)["suggested_radius"] / 2)
        return ["search", path, "-r", radius, "-o", self.path("x.npz"), "--lists", "distance", "-T", "1"]

    def test_while_writing(self):
        self.stop(signal.SIGINT, 130, 56, *self.long_writing())

    def writing(self, *args):
        """The program once something is in its file; killed at the end, if it has not ended by itself."""
        process = self.start(54, *args)
        self.addCleanup(process.kill)
        while process.poll() is None and not any(os.path.getsize(self.path(name)) for name in self.temporary_files()):
            time.sleep(0.001)
        return process

    def temporary_files(self):
        return [name for name in os.listdir(self.folder) if "tmp" in name]

    def test_killed_while_writing(self):
        """A second signal, and signals whose default is to end the process, kill at once and leave nothing either."""
        args = self.long_writing()
        before = sorted(os.listdir(self.folder))
        for numbers in ([signal.SIGINT, signal.SIGTERM], [signal.SIGHUP, signal.SIGINT], [signal.SIGQUIT],
                        [signal.SIGABRT], [signal.SIGUSR1], [signal.SIGUSR2], [signal.SIGXCPU], [signal.SIGALRM],
                        [signal.SIGVTALRM], [signal.SIGPROF]):
            process = self.writing(*args)
            process.send_signal(signal.SIGSTOP) # the signals are there together
            for number in numbers:
                process.send_signal(number)
            process.send_signal(signal.SIGCONT)
            process.communicate()
            self.assertIn(-process.returncode, numbers)
            self.assertEqual(sorted(os.listdir(self.folder)), before)

    def test_what_asks_nobody_is_ended(self):
        """A step that does not stop, here a flush of 30 s, ends with the message and the code of one that does."""
        before = sorted(os.listdir(self.folder))
        for number, code in ((signal.SIGINT, 130), (signal.SIGTERM, 143), (signal.SIGHUP, 129)):
            calls = self.path("calls")
            process = subprocess.Popen([cli_case.BINARY, "scene", "block", "-n", "1000", "-o", self.path("x.vdb"), "--sync"],
                                       stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
                                       env=cli_case.watched(VDB_NNS_SLOW_FLUSH="30", VDB_NNS_CALLS=calls))
            self.addCleanup(process.kill)
            while process.poll() is None and not os.path.exists(calls):
                time.sleep(0.001)
            start = time.monotonic()
            process.send_signal(number)
            out, err = process.communicate()
            self.assertLess(time.monotonic() - start, 10)
            self.assertEqual((process.returncode, out), (code, ""), err)
            self.assertEqual(err, f"vdb_nns: stopped by {signal.Signals(number).name}\n")
            os.remove(calls)
            self.assertEqual(sorted(os.listdir(self.folder)), before)

    def test_killed_while_the_file_is_created(self):
        """The name is known to the signal handler before the file is there."""
        before = sorted(os.listdir(self.folder))
        for number in (signal.SIGQUIT, signal.SIGUSR1):
            done = subprocess.run([cli_case.BINARY, "scene", "block", "-n", "1000", "-o", self.path("x.vdb")],
                                  capture_output=True, env=cli_case.watched(VDB_NNS_SIGNAL_AT_CREATE=str(int(number))))
            self.assertEqual(done.returncode, -number, done.stderr)
            self.assertEqual(sorted(os.listdir(self.folder)), before)

    def test_what_kill_leaves_goes_with_the_next_run(self):
        args = self.long_writing()
        before = sorted(os.listdir(self.folder))
        process = self.writing(*args)
        process.kill()
        process.communicate()
        left = set(os.listdir(self.folder)) - set(before)
        self.assertEqual(len(left), 1)
        self.assertRegex(left.pop(), rf"^x\.npz\.vdb_nns-{cli_case.host_mark()}-[0-9a-f]+-[0-9a-f]+\.tmp$")
        other = self.text(f"y.npz.vdb_nns-{cli_case.host_mark()}-1-0.tmp", "of another target")
        self.succeeds(*args, "-q")
        self.assertEqual(sorted(os.listdir(self.folder)), sorted([*before, "x.npz", os.path.basename(other)]))

    def test_what_a_living_process_writes_is_left_alone(self):
        args = self.long_writing()
        process = self.writing(*args, "-f")
        process.send_signal(signal.SIGSTOP)
        temporary = self.temporary_files()
        self.assertEqual(len(temporary), 1)
        self.succeeds(*args, "-q")
        os.rename(self.path("x.npz"), self.path("first.npz"))
        self.assertEqual(self.temporary_files(), temporary)
        process.send_signal(signal.SIGCONT)
        process.communicate()
        self.assertEqual(process.returncode, 0)
        self.assertEqual(self.bytes(self.path("x.npz")), self.bytes(self.path("first.npz")))

    def test_ignored_on_entry(self):
        """As by nohup."""
        args, ignored = self.long_writing(), (signal.SIGHUP, signal.SIGQUIT, signal.SIGUSR1, signal.SIGALRM)
        with self.start(80, *args, preexec_fn=lambda: [signal.signal(each, signal.SIG_IGN)
                                                       for each in ignored]) as process:
            for number in ignored:
                process.send_signal(number)
            process.communicate()
        self.assertEqual(process.returncode, 0)
        self.assertTrue(os.path.exists(self.path("x.npz")))

    def test_while_making_a_scene(self):
        self.stop(signal.SIGTERM, 143, 1, "scene", "clusters", "-n", "20M", "-o", self.path("big.vdb"), "-T", "1")

    def test_while_measuring(self):
        self.stop(signal.SIGINT, 130, 31, "bench", "--scene", "block", "-n", "50k", "--repeat", "5000",
                  "--csv", self.path("x.csv"))
        for study in ("resolution", "scaling", "model"):
            self.stop(signal.SIGINT, 130, 31, "bench", "--scene", "block", "-n", "2k", "--repeat", "1000", "--study", study,
                      "--json", self.path("x.json"))
