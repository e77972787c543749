"""Standard streams: closed ones change no file, a full one is an error, and nothing from outside controls the terminal."""
import csv
import itertools
import json
import os
import subprocess
import xml.etree.ElementTree

import numpy as np

import cli_case
from cli_case import CliCase, run
from test_outputs import without_uuid

STREAMS = (0, 1, 2)
CLOSED = [closed for count in range(1, 4) for closed in itertools.combinations(STREAMS, count)]


def close(descriptors):
    """For preexec_fn."""
    return lambda: [os.close(descriptor) for descriptor in descriptors]


class ClosedStreams(CliCase):
    """The next file that is opened gets a number that is free: with stderr closed, talk would go into it."""

    def outputs(self, folder, *args, closed=()):
        """The files that a command with all its talk writes, by name."""
        os.mkdir(self.path(folder))
        args = [arg.replace("OUT/", self.path(folder) + "/") for arg in args]
        done = run(*args, "--progress", "always", "-v", preexec_fn=close(closed))
        self.assertEqual(done.code, 0, f"{args} with {closed} closed\n{done.err}")
        names = os.listdir(self.path(folder))
        return {name: self.content(os.path.join(self.path(folder), name)) for name in names}

    def content(self, path):
        """What is the same in each run."""
        if path.endswith(".json"):
            with open(path) as file:
                return json.load(file).keys()
        if path.endswith(".csv"):
            with open(path, newline="") as file:
                return [(row["method"], row["pairs"], len(row)) for row in csv.DictReader(file)]
        return without_uuid(path) if path.endswith(".vdb") else self.bytes(path)

    def test_every_output(self):
        scene = self.scene()
        commands = {
            "npz": ["search", scene, "-o", "OUT/x.npz", "-T", "1"],
            "vdb": ["search", scene, "-o", "OUT/x.vdb", "-T", "1"],
            "json": ["search", scene, "--json", "OUT/x.json"],
            "svg": ["plan", scene, "--svg", "OUT/x.svg", "-T", "1"],
            "csv": ["bench", scene, "--method", "ours-count", "--repeat", "1", "--sample", "0", "--csv", "OUT/x.csv",
                    "--points-out", "OUT/x.raw"],
            "scene": ["scene", "block", "-n", "500", "-o", "OUT/s.vdb"],
        }
        for name, args in commands.items():
            expected = self.outputs(name, *args)
            self.assertTrue(expected)
            for closed in CLOSED:
                found = self.outputs(name + "".join(map(str, closed)), *args, closed=closed)
                self.assertEqual(found, expected, f"{name} with {closed} closed")


    def test_what_is_asked_for_on_stdout(self):
        """Refused before anything is made. A summary is not missed."""
        scene, lists = self.scene(), self.path("x.npz")
        self.succeeds("search", scene, "-o", lists, "-q")
        for args in (["search", scene, "-o", self.path("y.npz")], ["plan", scene], ["info", scene],
                     ["bench", scene, "--csv", self.path("x.csv")], ["verify", scene, lists],
                     ["scene", "block", "-n", "10", "-o", self.path("y.vdb")]):
            self.fails(6, *args, "--json", "-", says=["standard output", "closed"], preexec_fn=close([1]))
        for args in (["--help"], ["--version"], ["--help-markdown"]):
            self.fails(6, *args, says=["standard output", "closed"], preexec_fn=close([1]))
        self.assertEqual(run("info", scene, preexec_fn=close([1])), (0, "", ""))


class FullStdout(CliCase):
    def test_is_an_error(self):
        if not os.path.exists("/dev/full"):
            self.skipTest("no /dev/full")
        scene = self.scene()
        for args in (["search", scene], ["search", scene, "--json", "-"], ["info", scene], ["--version"], ["--help"],
                     ["plan", scene], ["scene", "block", "-n", "10", "-o", self.path("s.vdb"), "-f"]):
            done = self.into_full_device(*args)
            self.assertEqual(done.code, 6, args)
            self.assertIn("standard output", done.err)

    def into_full_device(self, *args):
        with open("/dev/full", "w") as full:
            return run(*args, preexec_fn=lambda: os.dup2(full.fileno(), 1))


class Terminal(CliCase):
    """Control characters in names, paths and headers are shown and do nothing."""
    EVIL = b"\x1b]0;t\x07\x7f\xc2\x9b31m\r\xff\xc0\xaf\xed\xa0\x80\n"
    SHOWN = "\\x1B]0;t\\x07\\x7F\\xC2\\x9B31m\\x0D\\xFF\\xC0\\xAF\\xED\\xA0\\x80\\x0A"
    HARMLESS = "\u00e4 \u65e5\u672c \U0001f30a \\ "

    def says(self, *args, code=0, shown=SHOWN):
        done = subprocess.run([cli_case.BINARY, *args], stdout=subprocess.PIPE, stderr=subprocess.PIPE, timeout=300)
        out = done.stdout.decode() + done.stderr.decode() # valid UTF-8
        self.assertEqual(done.returncode, code, out)
        for line in out.split("\n"):
            self.assertTrue(line.isprintable(), repr(line))
        self.assertIn(shown, out)
        return out

    def test_paths(self):
        name = os.fsencode(self.path(self.HARMLESS)) + self.EVIL
        shown, radius = self.HARMLESS + self.SHOWN, ["-r", "1"]
        np.save(self.path("x.npy"), np.zeros((10, 3), np.float32))
        os.rename(self.path("x.npy"), name + b".npy")
        verbose = ["--progress", "always", "-v"]
        self.says("info", name + b".npy", *verbose, shown=shown)
        self.says("search", name + b".npy", *radius, "-o", name + b".npz", *verbose, shown=shown)
        self.says("plan", name + b".npy", *radius, "--svg", name + b".svg", *verbose, shown=shown)
        xml.etree.ElementTree.parse(os.fsdecode(name + b".svg"))
        self.says("bench", name + b".npy", *radius, "--method", "ours-count", "--csv", name + b".csv", "--repeat", "1",
                  shown=shown)
        self.assertIn(shown, self.bytes(name + b".csv").decode())
        self.says("scene", "block", "-n", "10", "-o", name + b".vdb", shown=shown)
        self.says("info", name + b".vdb", shown=shown)
        self.says("info", name + b".vdb", "-g", name, code=2, shown=shown)
        self.says("search", name + b".vdb", "-o", name + b".vdb", code=2, shown=shown)
        self.says("search", name + b".missing.npy", *radius, code=3, shown=shown)
        self.says("search", name, *radius, code=2, shown=shown)
        self.says(name, code=2)
        self.says("search", b"--" + self.EVIL, code=2)
        self.says("search", name + b".npy", "-r", self.EVIL, code=2)

    def test_headers(self):
        header = b"{'descr': '" + self.EVIL[:-1] + b"', 'fortran_order': False, 'shape': (1, 3), }\n"
        npy = self.text("x.npy", b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header)
        self.says("info", npy, code=3, shown="\\x1B]0;t\\x07")
        ply = self.text("x.ply", b"ply\nformat ascii 1.0\nelement vertex 1\nproperty " + self.EVIL + b"x\nend_header\n1\n")
        self.says("info", ply, code=3, shown="\\x1B]0;t\\x07")

    def test_grid_names(self):
        path = self.scene("block", 100)
        self.assertIn(b"\x06\0\0\0points", self.bytes(path))
        evil = self.text("evil.vdb", self.bytes(path).replace(b"\x06\0\0\0points", b"\x06\0\0\0\x1b[31mp"))
        self.says("info", evil, shown="\\x1B[31mp")
        self.says("info", evil, "-g", "none", code=2, shown="\\x1B[31mp")
        self.says("search", evil, "-g", "\x1b[31mp", "-r", "1e-15", code=3, shown="\\x1B[31mp")
