"""search --frames: the files of a single search of each, whatever fails beside them."""
import json
import os
import signal
import subprocess
import time

import numpy as np

import cli_case
from cli_case import CliCase


class Frames(CliCase):
    def frames(self, *numbers, count=3000):
        """Scenes in.0001.vdb and so on, each another one; the pattern that names them."""
        for number in numbers:
            self.succeeds("scene", "clusters", "-n", count, "--seed", number, "-o", self.path(f"in.{number:04}.vdb"), "-q")
        return self.path("in.####.vdb")

    def names(self, *beginnings):
        return sorted(name for name in os.listdir(self.folder) if name.startswith(beginnings))

    def same_vdb(self, a, b):
        """But for the UUID."""
        a, b = self.bytes(a), self.bytes(b)
        self.assertEqual((a[:21], a[57:]), (b[:21], b[57:]))

    def test_files_of_single_searches(self):
        pattern = self.frames(1, 2, 3, 4)
        attributes = ["--attributes", "count,density,normal"]
        for k, more in enumerate([[], ["-T", "1"], ["-T", "4"], ["--host-memory", "1G"], ["--device", "sim"]]):
            done = self.succeeds("search", pattern, "--frames", "1-4", "-o", self.path(f"a{k}.%04d.npz"), "-o",
                                 self.path(f"b{k}.$F4.vdb"), "--attributes-output", self.path(f"c{k}.####.npz"), *attributes, *more)
            self.assertEqual([line.split()[:2] for line in done.out.splitlines()[:4]], [["frame", str(n)] for n in range(1, 5)])
            self.assertIn("4 made", done.out)
            for n in range(1, 5):
                if k == 0:
                    self.succeeds("search", self.path(f"in.{n:04}.vdb"), "-o", self.path(f"one.{n}.npz"), "-o",
                                  self.path(f"one.{n}.vdb"), "--attributes-output", self.path(f"arrays.{n}.npz"), *attributes, "-q")
                self.assertEqual(self.bytes(self.path(f"a{k}.{n:04}.npz")), self.bytes(self.path(f"one.{n}.npz")))
                self.assertEqual(self.bytes(self.path(f"c{k}.{n:04}.npz")), self.bytes(self.path(f"arrays.{n}.npz")))
                self.same_vdb(self.path(f"b{k}.{n:04}.vdb"), self.path(f"one.{n}.vdb"))

    def test_places_and_ranges(self):
        for n in (1, 3, 12, 100):
            np.save(self.path(f"p{n}.npy"), np.random.default_rng(n).random((50, 3)))
        for frames, numbers in (("1-3x2", [1, 3]), ("100,1,3", [100, 1, 3]), ("12", [12]), ("3-12x9,1", [3, 12, 1])):
            report = self.report("search", self.path("p#.npy"), "-r", "0.3", "--frames", frames)
            self.assertEqual([frame["frame"] for frame in report["frames"]], numbers)
            self.assertEqual([frame["input"]["path"] for frame in report["frames"]], [self.path(f"p{n}.npy") for n in numbers])
        for place, name in (("##", "03"), ("%d", "3"), ("%05d", "00003"), ("$F", "3"), ("$F3", "003"), ("#_%02d", "3_03")):
            self.succeeds("search", self.path("p$F.npy"), "-r", "0.3", "--frames", "3", "-o", self.path(f"o.{place}.npz"), "-q")
            self.assertEqual(self.names("o."), [f"o.{name}.npz"])
            os.remove(self.path(f"o.{name}.npz"))
        np.save(self.path("m-2.npy"), np.zeros((2, 3)))
        np.save(self.path("m0.npy"), np.zeros((2, 3)))
        report = self.report("search", self.path("m#.npy"), "-r", "1", "--frames", "-2-0x2")
        self.assertEqual([frame["frame"] for frame in report["frames"]], [-2, 0])
        # Other signs in folders are names where the file has a place.
        os.mkdir(self.path("shot#3"))
        np.save(self.path("shot#3/p1$FF.npy"), np.zeros((2, 3)))
        self.succeeds("search", self.path("shot#3/p#$FF.npy"), "-r", "1", "--frames", "1", "-o", self.path("shot#3/l#.npz"), "-q")
        self.assertTrue(os.path.exists(self.path("shot#3/l1.npz")))
        # A folder may have the number, too; and without --frames such a name is a name.
        os.mkdir(self.path("f007"))
        os.rename(self.path("m0.npy"), self.path("f007/m#.npy"))
        self.succeeds("search", self.path("f007/m#.npy"), "-r", "1", "-q")
        os.rename(self.path("f007/m#.npy"), self.path("f007/m.npy"))
        self.succeeds("search", self.path("f###/m.npy"), "-r", "1", "--frames", "7", "-o", self.path("f###/l.npz"), "-q")
        self.assertTrue(os.path.exists(self.path("f007/l.npz")))

    def test_other_files_of_a_frame(self):
        rng = np.random.default_rng(1)
        for n in (1, 2):
            np.save(self.path(f"c.{n}.npy"), rng.random((300, 3)))
            np.save(self.path(f"q.{n}.npy"), rng.random((70, 3)))
            np.save(self.path(f"r.{n}.npy"), rng.random(70) / 5)
        flags = ["--radius-scale", "0.9", "--lists", "distance"]
        self.succeeds("search", self.path("c.%d.npy"), "--queries", self.path("q.%d.npy"), "--queries-radius-file", self.path("r.#.npy"),
                      "--frames", "1-2", "-o", self.path("out.#.npz"), *flags, "-q")
        for n in (1, 2):
            self.succeeds("search", self.path(f"c.{n}.npy"), "--queries", self.path(f"q.{n}.npy"), "--queries-radius-file",
                          self.path(f"r.{n}.npy"), "-o", self.path("one.npz"), *flags, "-q", "-f")
            self.assertEqual(self.bytes(self.path(f"out.{n}.npz")), self.bytes(self.path("one.npz")))
        # One file may serve all frames.
        report = self.report("search", self.path("c.%d.npy"), "--queries", self.path("q.1.npy"), "-r", "0.1", "--frames", "1-2")
        self.assertEqual([frame["queries"]["path"] for frame in report["frames"]], [self.path("q.1.npy")] * 2)

    def test_bad_frames_are_named_and_the_others_made(self):
        pattern = self.frames(1, 2, 4, 5, 6)
        with open(self.path("in.0004.vdb"), "r+b") as file:
            file.truncate(5000)
        done = cli_case.run("search", pattern, "--frames", "1-6", "-o", self.path("out.####.npz"), "--json", self.path("r.json"))
        self.assertEqual(done.code, 3, done.err)
        errors = [line for line in done.err.splitlines() if "error" in line]
        self.assertEqual(len(errors), 2, done.err)
        self.assertTrue(errors[0].startswith("vdb_nns: error: frame 3: " + self.path("in.0003.vdb")), errors)
        self.assertTrue(errors[1].startswith("vdb_nns: error: frame 4: " + self.path("in.0004.vdb")), errors)
        self.assertEqual(self.names("out."), [f"out.{n:04}.npz" for n in (1, 2, 5, 6)])
        self.assertIn("4 made, 2 failed", done.out)
        with open(self.path("r.json")) as file:
            report = json.load(file)
        self.assertEqual((report["schema"], report["command"], report["made"], report["failed"], report["skipped"]), (1, "search", 4, 2, 0))
        for n, frame in enumerate(report["frames"], 1):
            self.assertEqual((frame["frame"], frame["input"]["path"]), (n, self.path(f"in.{n:04}.vdb")))
            if n in (3, 4):
                self.assertEqual((frame["result"], frame["exit"], frame["skipped"]), (None, 3, False))
                self.assertIn(f"in.{n:04}.vdb", frame["error"])
            else:
                single = self.report("search", self.path(f"in.{n:04}.vdb"), "-o", self.path("one.npz"), "-f")
                self.assertEqual(frame["result"], single["result"])
                self.assertEqual(set(single) - set(frame), set())

    def test_exit_code_of_the_lowest_frame(self):
        for n in (1, 2, 3):
            points = np.random.default_rng(n).random((20, 3))
            if n == 2:
                points[4, 1] = np.nan
            np.save(self.path(f"p{n}.npy"), points)
        self.text("p3.npy", "no array")
        command = ["search", self.path("p#.npy"), "-r", "0.2", "--nonfinite", "fail", "-o", self.path("o#.npz")]
        done = cli_case.run(*command, "--frames", "3,2,1")
        self.assertEqual(done.code, 1, done.err)
        self.assertEqual(self.names("o"), ["o1.npz"])
        self.assertEqual(cli_case.run(*command, "--frames", "3").code, 3)

    def test_skip_existing(self):
        pattern = self.frames(1, 2, 3)
        command = ["search", pattern, "--frames", "1-3", "-o", self.path("a.####.npz"), "-o", self.path("b.####.vdb")]
        self.succeeds(*command, "-q")
        self.fails(2, *command, says=[self.path("a.0001.npz"), "exists"])
        first = {name: self.bytes(self.path(name)) for name in self.names("a.", "b.")}
        self.text("a.0001.npz", "mine")  # is there, and so is b: nobody looks into it
        os.remove(self.path("a.0002.npz"))
        os.remove(self.path("a.0003.npz"))
        os.remove(self.path("b.0003.vdb"))
        report = self.report(*command, "--skip-existing")
        self.assertEqual((report["made"], report["skipped"], report["failed"]), (2, 1, 0))
        self.assertEqual([frame.get("skipped", False) for frame in report["frames"]], [True, False, False])
        self.assertEqual(self.bytes(self.path("a.0001.npz")), b"mine")
        self.assertEqual(self.names("a.", "b."), sorted(first))
        for n in (2, 3):
            self.assertEqual(self.bytes(self.path(f"a.000{n}.npz")), first[f"a.000{n}.npz"])
        self.assertIn("3 were there", self.succeeds(*command, "--skip-existing").out)

    def test_skip_existing_loses_nothing(self):
        """What is there stays as it is, input and report among it; what is missing is made, and flags are checked all the same."""
        pattern = self.frames(1, 2)
        inputs = [self.bytes(self.path(f"in.000{n}.vdb")) for n in (1, 2)]
        command = ["search", pattern, "--frames", "1-2", "-o", pattern, "-o", self.path("out.####.npz"), "--attributes",
                   "density", "--kernel", "poly6", "--skip-existing", "--json", self.path("r.json")]
        for made in (2, 0):
            self.succeeds(*command)
            with open(self.path("r.json")) as file:
                self.assertEqual(json.load(file)["made"], made)
            self.assertEqual([self.bytes(self.path(f"in.000{n}.vdb")) for n in (1, 2)], inputs)
            self.assertEqual(self.names("out."), ["out.0001.npz", "out.0002.npz"])
        self.fails(2, *command, "-r", "-5", says="--radius")
        # Flags about an output that is there do not trouble the others.
        command = ["search", pattern, "--frames", "1-2", "-o", self.path("p.#.ply"), "-o", self.path("v.#.vdb"), "--keep", "none",
                   "--attributes", "density"]
        self.succeeds(*command, "-q")
        os.remove(self.path("v.2.vdb"))
        self.assertEqual(self.report(*command, "--skip-existing")["made"], 1)
        # An attribute that exists is not replaced either.
        self.succeeds("search", self.path("in.0001.vdb"), "-o", self.path("has.0001.vdb"), "-q")
        self.fails(2, "search", self.path("has.0001.vdb"), "-o", self.path("x.vdb"), says="nns_count")
        done = cli_case.run("search", self.path("has.####.vdb"), "--frames", "1", "-o", self.path("y.####.vdb"), "-o",
                            self.path("out.####.npz"), "--skip-existing")
        self.assertEqual(done.code, 2)
        self.assertIn("nns_count", done.err)

    def test_summary_that_cannot_be_written(self):
        """The frames are made; the program says so once."""
        self.frames(1, 2, 3)
        with open("/dev/full", "w") as full:
            done = subprocess.run([cli_case.BINARY, "search", self.path("in.####.vdb"), "--frames", "1-3", "-o",
                                   self.path("out.####.npz"), "--json", self.path("r.json")], stdout=full, stderr=subprocess.PIPE, text=True)
        self.assertEqual(done.returncode, 6)
        self.assertEqual(done.stderr.count("error"), 1, done.stderr)
        self.assertEqual(len(self.names("out.")), 3)
        with open(self.path("r.json")) as file:
            self.assertEqual(json.load(file)["made"], 3)

    def test_memory_of_each_frame(self):
        """A bound that suffices for one frame suffices for every one."""
        path = self.scene("block", 300000)
        for n in range(1, 5):
            os.link(path, self.path(f"in.{n}.vdb"))
        for bound in range(80, 130, 4):
            single = cli_case.run("search", path, "--host-memory", f"{bound}MB", "-o", self.path("one.npz"), "-q", "-f")
            if single.code == 0:
                break
        # The first bound that suffices, and some for what differs from run to run.
        self.succeeds("search", self.path("in.#.vdb"), "--frames", "1-4", "--host-memory", f"{bound + 6}MB", "-o",
                      self.path("out.#.npz"), "-q")
        for n in range(1, 5):
            self.assertEqual(self.bytes(self.path(f"out.{n}.npz")), self.bytes(self.path("one.npz")))

    def test_refused(self):
        pattern = self.frames(1, 2)
        one = self.path("in.0001.vdb")
        out = self.path("out.####.npz")
        self.fails(2, "search", one, "--frames", "1-2", says=[one, "place for the number"])
        self.fails(2, "search", pattern, "--frames", "1-2", "-o", self.path("x.npz"), says=[self.path("x.npz"), "every frame"])
        self.fails(2, "search", pattern, "--frames", "1-2", "--attributes-output", self.path("x.npz"), says=self.path("x.npz"))
        for frames in ("2-1", "1-2x0", "a", "1-", "1,,2", "1-2,2", "1-2x", "", "1 - 2", "1-100001", "12345678901", "1-12345678901"):
            self.fails(2, "search", pattern, "--frames", frames, "-o", out, says="--frames")
        self.fails(2, "search", pattern, "--skip-existing", says="--frames")
        self.fails(2, "search", one, "--skip-existing", says="--frames")
        self.fails(2, "search", pattern, "--frames", "1-2", "--skip-existing", says="--skip-existing")
        self.fails(2, "search", pattern, "--frames", "1-2", "--skip-existing", "-f", "-o", out, says="--force")
        self.fails(2, "search", pattern, "--frames", "1-2", "-r", "-1", says="--radius")
        self.fails(3, "search", pattern, says=[pattern, "--frames"])
        self.fails(3, "search", self.path("x" * 300 + "#.vdb"), says="--frames")
        self.fails(3, "search", pattern, "--frames", "7-9", "-o", out, says=["none of the frames 7-9", "in.0007.vdb"])
        # What one frame would write, another one reads.
        self.fails(2, "search", self.path("in.00##.vdb"), "--frames", "1,2,21", "-o", self.path("in.00#1.vdb"), "-f",
                   says=["in.0021.vdb", "read by frame 21", "written by frame 2"])

    def start(self, *args):
        return subprocess.Popen([cli_case.BINARY, *args], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)

    def until_there(self, process, name):
        while process.poll() is None and not os.path.exists(self.path(name)):
            time.sleep(0.001)
        self.assertIsNone(process.poll(), "it ended before it could be stopped")

    def many(self, count, frames):
        path = self.scene("dam_break", count)
        for n in range(1, frames + 1):
            os.link(path, self.path(f"in.{n:04}.vdb"))
        return ["search", self.path("in.####.vdb"), "--frames", f"1-{frames}", "-o", self.path("out.####.npz")]

    def test_stopped_and_killed(self):
        """Whole files are left, and the next run makes the rest."""
        command = self.many(60000, 40)
        self.succeeds("search", self.path("in.0001.vdb"), "-o", self.path("one.npz"), "-q")
        whole = self.bytes(self.path("one.npz"))
        for stop, code in ((signal.SIGINT, 130), (signal.SIGTERM, 143), (signal.SIGKILL, -9)):
            process = self.start(*command)
            self.until_there(process, "out.0003.npz")
            process.send_signal(stop)
            out, err = process.communicate()
            self.assertEqual(process.returncode, code, err)
            made = [name for name in self.names("out.") if name.endswith(".npz")]
            self.assertLess(len(made), 40)
            for name in made:
                self.assertEqual(self.bytes(self.path(name)), whole)
            if code != -9:
                self.assertEqual(self.names("out."), made)
                self.assertNotIn("error", err)
                for name in made:
                    os.remove(self.path(name))
        report = self.report(*command, "--skip-existing")
        self.assertEqual((report["made"], report["skipped"]), (40 - len(made), len(made)))
        self.assertEqual(self.names("out."), [f"out.{n:04}.npz" for n in range(1, 41)])

    def test_full_disk(self):
        """Each frame that has no room is named; no file is left under its name."""
        pattern = self.frames(1, 2, 3)
        done = cli_case.run("search", pattern, "--frames", "1-3", "-o", self.path("out.####.npz"),
                            preexec_fn=cli_case.limit_file_size(20000))
        self.assertEqual(done.code, 6, done.err)
        self.assertEqual(done.err.count("error: frame"), 3, done.err)
        self.assertEqual(self.names("out."), [])

    def test_progress_over_all(self):
        self.frames(1, 2)
        done = self.succeeds("search", self.path("in.####.vdb"), "--frames", "1-2", "--progress", "always", "-o", self.path("o.#.npz"))
        percents = [int(line[9:-1]) for line in done.err.splitlines() if line.startswith("PROGRESS")]
        self.assertEqual(percents, sorted(set(percents)))
        self.assertEqual((percents[0], percents[-1]), (0, 100))
