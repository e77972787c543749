"""SIGINT and SIGTERM: the exit code says which, and no file is left behind."""
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
        with subprocess.Popen([cli_case.BINARY, *args, "--progress", "always"], stdout=subprocess.PIPE,
                              stderr=subprocess.PIPE, text=True) as process:
            for line in process.stderr:
                if line.startswith("PROGRESS") and int(line[9:-2]) >= at_percent:
                    break
            start = time.monotonic()
            process.send_signal(number)
            rest = process.stderr.read()
            self.assertEqual(process.stdout.read(), "")
            process.wait()
        self.assertEqual(process.returncode, code, rest)
        self.assertLess(time.monotonic() - start, 10)
        self.assertIn("SIGINT" if number == signal.SIGINT else "SIGTERM", rest)
        self.assertNotIn("PROGRESS 100%", rest)
        self.assertEqual(sorted(os.listdir(self.folder)), before)

    def test_while_searching(self):
        path = self.scene("block", 100000)
        args = ["search", path, "-o", self.path("x.npz"), "--json", self.path("x.json"), "--repeat", "2000"]
        self.stop(signal.SIGINT, 130, 21, *args)
        self.stop(signal.SIGTERM, 143, 21, *args)

    def test_while_writing(self):
        path = self.scene("block", 100000)
        radius = repr(3.5 * self.report("info", path)["suggested_radius"] / 2)
        # About 180 neighbors a particle: writing them with distances takes far longer than a signal to arrive.
        args = ["search", path, "-r", radius, "-o", self.path("x.npz"), "--lists", "distance", "-T", "1"]
        self.stop(signal.SIGINT, 130, 80, *args)

    def test_while_making_a_scene(self):
        self.stop(signal.SIGTERM, 143, 1, "scene", "clusters", "-n", "20M", "-o", self.path("big.vdb"), "-T", "1")

    def test_while_measuring(self):
        self.stop(signal.SIGINT, 130, 31, "bench", "--scene", "block", "-n", "50k", "--repeat", "5000",
                  "--csv", self.path("x.csv"))
        for study in ("resolution", "scaling", "model"):
            self.stop(signal.SIGINT, 130, 31, "bench", "--scene", "block", "-n", "2k", "--repeat", "1000", "--study", study,
                      "--json", self.path("x.json"))
