"""Standard streams that are closed, full or broken: no file has anything in it that is not its own."""
import csv
import itertools
import json
import os

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


class FullStdout(CliCase):
    def test_is_an_error(self):
        scene = self.scene()
        for args in (["search", scene], ["search", scene, "--json", "-"], ["info", scene], ["--version"], ["--help"],
                     ["plan", scene], ["scene", "block", "-n", "10", "-o", self.path("s.vdb"), "-f"]):
            done = self.into_full_device(*args)
            self.assertEqual(done.code, 6, args)
            self.assertIn("standard output", done.err)

    def into_full_device(self, *args):
        with open("/dev/full", "w") as full:
            return run(*args, preexec_fn=lambda: os.dup2(full.fileno(), 1))
