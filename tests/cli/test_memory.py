"""--host-memory: the most memory of the whole process. Whatever the bound takes away, the file is the same."""
import filecmp
import json
import os
import re
import resource
import shutil
import unittest.mock

import numpy as np

import cli_case
from cli_case import CliCase, limit_address_space, limit_file_size, run

MB = 10 ** 6


class Bound(CliCase):
    def setUp(self):
        super().setUp()
        self.free, self.out = self.path("free.npz"), self.path("bounded.npz")

    def search(self, path, *args):
        """Without a bound: what the bounded runs are compared with."""
        self.args = (path, *args)
        report = self.report("search", *self.args, "-o", self.free)
        self.assertIsNone(report["device"]["budget_bytes"])
        return report

    def bounded(self, megabytes, encoding, list_bytes_below, *args):
        """Within the bound, in the encoding, with the same file and the same result; returns the report."""
        with self.subTest(megabytes=megabytes, args=args):
            if "-T" not in args:
                args = (*args, "-T", "2")  # something is kept for every thread
            report = self.report("search", *self.args, "-o", self.out, "-f", "--host-memory", f"{megabytes}MB", *args)
            self.assertLessEqual(report["memory"]["peak_rss_bytes"], megabytes * MB)
            self.assertEqual(report["devices"][-1]["budget_bytes"], megabytes * MB)
            self.assertEqual(report["plan"]["encoding"], encoding)
            self.assertLess(report["memory"]["list_bytes"], list_bytes_below)
            self.assertTrue(filecmp.cmp(self.free, self.out, shallow=False))
            self.assertEqual(sorted(name for name in os.listdir(self.folder) if "tmp" in name), [])
            return report

    def test_rows_go_to_the_file_as_they_are_found(self):
        # 31 M pairs: 124 MB as indices. Particles are numbered along space, and nobody reads their lists but the file.
        path = self.scene("block", 300000)
        held = self.search(path, "-r", "0.3", "--encoding", "index")
        free = self.search(path, "-r", "0.3", "-f")
        pair_bytes = 4 * free["result"]["pairs"]
        self.assertGreater(held["memory"]["peak_rss_bytes"], 45 * MB + pair_bytes)
        self.assertLess(free["memory"]["peak_rss_bytes"], held["memory"]["peak_rss_bytes"] - pair_bytes / 2)
        self.assertEqual(free["result"], held["result"])
        self.assertTrue(free["plan"]["straight_to_file"])
        self.assertFalse(held["plan"]["straight_to_file"])
        for threads in ("1", "2"):
            for megabytes in (300, 200, 110):
                report = self.bounded(megabytes, "index", 9 * 300000, "-T", threads)
                self.assertEqual(report["result"], free["result"])
                self.assertEqual(report["plan"]["candidate_tests"], free["plan"]["candidate_tests"])

    def test_crowded_rows_go_to_the_file_as_they_are_found(self):
        # 25000 candidates a query, and 2000 neighbors: memory that rows ask for and do not use serves others.
        path = self.npy("crowd.npy", np.random.default_rng(1).random((25000, 3)))
        args = ("-r", "0.3", "--cell-size", "3")
        self.search(path, *args, "--encoding", "index")
        self.args = (path, *args)
        report = self.bounded(250, "index", 9 * 25000)
        self.assertTrue(report["plan"]["straight_to_file"])
        self.assertLess(report["memory"]["peak_rss_bytes"], 170 * MB)
        done = self.succeeds("search", *self.args, "-o", self.out, "-f", "-T", "2", "--host-memory", "250MB")
        self.assertEqual(done.err, "")  # no second search for what did not fit

    def test_index_then_straight_to_the_file(self):
        # 31 M pairs: 124 MB as indices, about 25 as masks. The program alone is some 45 MB.
        path = self.scene("block", 300000)
        free = self.search(path, "-r", "0.3", "--repeat", "2")
        pair_bytes = 4 * free["result"]["pairs"]
        self.assertGreater(free["memory"]["peak_rss_bytes"], 45 * MB + pair_bytes)
        for threads in ("1", "2"):
            for megabytes, encoding, most in ((300, "index", 1.1 * pair_bytes), (200, "index", 9 * 300000),
                                              (110, "index", 9 * 300000)):
                report = self.bounded(megabytes, encoding, most, "-T", threads)
                self.assertEqual(report["result"], free["result"])
                self.assertEqual(report["plan"]["candidate_tests"], free["plan"]["candidate_tests"])
        self.bounded(200, "index", 9 * 300000, "--encoding", "index")
        self.fails(4, "search", *self.args, "-o", self.path("x.npz"), "--encoding", "mask", "-T", "2", "--host-memory",
                   "120MB", says=["mask lists need", "bytes", "the host memory allowed, which is 120000000"])

    def test_index_mask_file(self):
        # Numbered at random, each row would be a write of its own: masks first. Who asks for indices is not given masks.
        points = np.random.default_rng(1).random((300000, 3)) * 30
        free = self.search(self.npy("random.npy", points), "-r", "1.3")
        pair_bytes = 4 * free["result"]["pairs"]
        for megabytes, encoding, most in ((300, "index", 1.1 * pair_bytes), (190, "mask", 0.35 * pair_bytes),
                                          (110, "index", 9 * 300000)):
            report = self.bounded(megabytes, encoding, most)
            self.assertEqual(report["result"], free["result"])
        self.bounded(190, "index", 9 * 300000, "--encoding", "index")
        for megabytes, says in ((190, "index lists need [0-9]+ bytes .* held as masks"),
                                (110, "mask lists need [0-9]+ bytes .* straight to the file")):
            done = self.succeeds("search", *self.args, "-o", self.out, "-f", "--host-memory", f"{megabytes}MB", "-T", "2")
            self.assertRegex(done.err, says)

    def test_it_says_what_it_does(self):
        path = self.scene("block", 300000)
        flags = ("search", path, "-r", "0.3", "-o", self.out, "-f", "-T", "2", "--host-memory")
        done = self.succeeds(*flags, "200MB")
        self.assertEqual(done.err, "") # there are no lists that could fail to fit
        self.assertIn("straight to the file", done.out)
        flags += ("110MB",) # too little even for the rows that wait for others
        done = self.succeeds(*flags)
        self.assertRegex(done.err, "index lists need [0-9]+ bytes .* straight to the file")
        self.assertIn("straight to the file", done.out)
        self.assertEqual(self.succeeds(*flags, "-q").err, "")

    def test_simulated_devices_are_within_the_bound(self):
        # A device of 40 MB takes as much of this machine, and as much again for what is staged.
        path = self.scene("block", 300000)
        self.search(path, "-r", "0.3")
        for flags in (["--device-memory", "40MB"], ["--device-memory", "10MB", "--boundary", "cpu"]):
            for megabytes in (350, 220):
                report = self.bounded(megabytes, "index", 1 << 40, "--device", "sim", *flags)
                self.assertGreater(report["devices"][0]["particles"], 0)
        self.fails(4, "search", path, "-r", "0.3", "--checksum", "--device", "sim", "--device-memory", "2GB",
                   "--encoding", "index", "--host-memory", "130MB",
                   says=["buffers of the devices", "bytes", "the host memory allowed, which is 130000000"])

    def test_distances(self):
        self.search(self.scene("block", 300000), "-r", "0.25", "--lists", "distance")
        self.bounded(110, "index", 9 * 300000)

    def test_random_order_nonfinite_and_empty_rows(self):
        rng = np.random.default_rng(1)
        points = rng.random((200000, 3)) * 30
        points[rng.integers(0, len(points), 500)] = np.nan
        alone = 1000 + 10 * np.arange(300).reshape(-1, 1) * np.ones(3)
        points = np.concatenate([points[:100000], alone, points[100000:], np.full((100, 3), np.inf)])
        free = self.search(self.npy("random.npy", points), "-r", "1.2")
        self.assertGreater(free["input"]["nonfinite"], 500)
        self.assertEqual(free["result"]["isolated"], 300)  # of the finite ones
        for threads in ("1", "2"):
            report = self.bounded(110, "index", 9 * len(points), "-T", threads)
            self.assertEqual(report["result"], free["result"])

    def test_crowds(self):
        # Rows of up to thousands of neighbors beside nearly empty ones.
        rng = np.random.default_rng(1)
        points = np.concatenate([rng.normal(0, 0.05, (40000, 3)), rng.random((60000, 3)) * 2])
        free = self.search(self.npy("crowd.npy", points), "-r", "0.04")
        self.assertGreater(free["result"]["max"], 2000)
        self.bounded(110, "index", 9 * len(points))

    def test_attributes_beside_lists(self):
        path = self.scene("block", 300000)
        self.search(path, "-r", "0.3", "-o", self.path("free.vdb"))
        self.args = (path, "-r", "0.3", "-o", self.path("bounded.vdb"))
        self.bounded(125, "index", 9 * 300000)
        counts = [self.report("info", self.path(name))["attributes"] for name in ("free.vdb", "bounded.vdb")]
        self.assertEqual(counts[0], counts[1])
        self.assertEqual(os.path.getsize(self.path("free.vdb")), os.path.getsize(self.path("bounded.vdb")))

    def test_measures(self):
        """Results of measures and the copy that a .vdb takes of them count: the run stays within the bound, or says what it needs."""
        path = self.scene("block", 500000)
        free, done = self.path("free.vdb"), 0
        self.succeeds("search", path, "--attributes", "density,pca", "-o", free, "-q")
        for output in (["-o", self.path("bounded.vdb")], ["--attributes-output", self.path("bounded.npz")],
                       ["-o", self.path("bounded.vdb"), "-o", self.path("lists.npz")]):
            for megabytes in (120, 150, 180, 210, 240):
                with self.subTest(output=output, megabytes=megabytes):
                    args = ["search", path, "--attributes", "density,pca", *output, "-f", "--host-memory", f"{megabytes}MB", "-T", "2"]
                    result = run(*args, "-q", "--json", self.path("report.json"))
                    self.assertIn(result.code, (0, 4), result.err)
                    if result.code == 4:
                        self.assertIn("host memory", result.err)
                        continue
                    done += 1
                    with open(self.path("report.json")) as file:
                        self.assertLessEqual(json.load(file)["memory"]["peak_rss_bytes"], megabytes * MB)
                    if output[0] == "-o":
                        self.assertEqual(os.path.getsize(free), os.path.getsize(output[1]))
        self.assertGreater(done, 3)

    def test_values_that_come_along(self):
        """So do values of the input, and a new grid of its points."""
        rng = np.random.default_rng(1)
        path, count = self.path("values.npz"), 1500000
        np.savez(path, positions=(rng.random((count, 3)) * 20).astype(np.float32), v=rng.random((count, 3)).astype(np.float32),
                 w=rng.random((count, 3)), fluid=rng.random(count) < 0.5)
        done = {}
        for keep in ("none", "all"):
            for output in ("x.vdb", "x.ply"):
                for megabytes in (140, 200, 260, 320, 380):
                    with self.subTest(keep=keep, output=output, megabytes=megabytes):
                        result = run("search", path, "--array", "positions", "-r", "0.2", "-o", self.path(output), "-f", "--keep", keep,
                                     "-T", "2", "--host-memory", f"{megabytes}MB", "-q", "--json", self.path("report.json"))
                        self.assertIn(result.code, (0, 4), result.err)
                        if result.code == 4:
                            self.assertIn("--host-memory", result.err)
                            continue
                        done.setdefault((keep, output), megabytes)
                        with open(self.path("report.json")) as file:
                            self.assertLessEqual(json.load(file)["memory"]["peak_rss_bytes"], megabytes * MB)
        self.assertEqual(len(done), 4, done)
        self.assertLess(done["none", "x.vdb"], done["all", "x.vdb"])

    def test_interrupted_by_a_full_disk(self):
        path = self.scene("block", 300000)
        os.mkdir(self.path("out"))
        self.fails(6, "search", path, "-r", "0.3", "-o", self.path("out/x.npz"), "--host-memory", "110MB", "-T", "2",
                   "-q", says="x.npz", preexec_fn=limit_file_size(50 * MB))
        self.assertEqual(os.listdir(self.path("out")), [])


class TooLittle(CliCase):
    def test_arrays_larger_than_the_memory(self):
        ply = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\nend_header\n"
        for name, head in (("large.xyz", "0 0 0\n"), ("large.ply", ply), ("large.npy", "\x93NUMPY")):
            path = self.text(name, head)
            try:
                os.truncate(path, 1 << 40)
            except OSError as error:
                self.skipTest(f"no sparse file of 1 TiB: {error}")
            for command in (["info", path], ["search", path, "-r", "1"], ["verify", path, "lists.npz", "-r", "1"]):
                with self.subTest(command=command):
                    message = self.fails(4, *command, says=[name, "need 1099511627776 bytes", "allowed are"]).err
                    # The advice once, and no flag that the command has not.
                    flags = "; the flags are --host-memory, --device-memory, --encoding and --radius"
                    self.assertTrue(message.endswith(": split the file, or let it have more memory" +
                                                     (flags if command[0] == "search" else "") + "\n"), message)
            os.truncate(path, 10 ** 9)
            for command in ("search", "plan", "bench"):
                self.fails(4, command, path, "-r", "1", "--host-memory", "500MB", says=[name, "need 1000000000 bytes"])
            os.remove(path)

    def test_text_whose_positions_do_not_fit(self):
        path = self.text("dense.xyz", "0 0 0\n" * 4000000)  # 24 MB, and 24 bytes for each position, once
        self.fails(4, "search", path, "-r", "1", "--host-memory", self.own_and(80),
                   says=["dense.xyz", "need 96000000 bytes of memory to be read"])
        # Once they fit, they are read, and it is the grid that does not fit.
        self.fails(4, "search", path, "-r", "1", "--host-memory", self.own_and(150),
                   says="grid of 4000000 particles")

    def own_and(self, megabytes):
        """A bound of what the program itself has before it reads a point, which hangs on its libraries, and so much more."""
        err = self.fails(4, "search", "none.npy", "-r", "1", "--host-memory", "10K").err
        return f"{float(re.search('the program itself takes ([0-9.]+) MiB', err)[1]) * 2**20 / 1e6 + megabytes:.3f}MB"

    def test_less_than_the_points(self):
        path = self.scene()
        for size in ("10K", self.own_and(-5)):
            self.fails(4, "search", path, "-o", self.path("x.npz"), "--host-memory", size,
                       says=["the program itself takes", "bytes", "--host-memory"])
        for command in (["search", path, "-o", self.path("x.npz")], ["plan", path]):
            done = self.fails(4, *command, "--host-memory", self.own_and(23),
                              says=["points alone need", "bytes", "--host-memory"])
            self.assertEqual(done.err.count("are kept for the threads"), 1, done.err)

    def test_less_than_the_grid(self):
        path = self.scene("block", 300000)
        self.fails(4, "search", path, "-o", self.path("x.npz"), "--host-memory", self.own_and(46),
                   says=["grid of 300000 particles", "bytes", "the host memory allowed, which is"])

    def test_less_than_the_counts(self):
        # Leaves that are taken over from the file need no sort, which would have left room for counts.
        path = self.scene("block", 2000000)
        done = self.fails(4, "search", path, "-r", "0.15", "-o", self.path("x.npz"), "--host-memory", self.own_and(110),
                          "-T", "1", says=["the grid and the counts of 2000000 particles need", "bytes", "--host-memory"])
        self.assertIn("index lists need", done.err)


class InAControlGroup(CliCase):
    def test_it_is_not_killed(self):
        path, free, out = self.scene("block", 2000000), self.path("free.npz"), self.path("bounded.npz")
        self.succeeds("search", path, "-r", "0.2", "-o", free, "-q")
        # How much the program takes by itself depends on its libraries; 400 MB are enough everywhere.
        for megabytes, expected in ((100, (0, 4)), (150, (0, 4)), (250, (0, 4)), (400, (0,))):
            with self.subTest(megabytes=megabytes), cli_case.memory_group(megabytes << 20) as enter:
                done = cli_case.run("search", path, "-r", "0.2", "-o", out, "-f", "-T", "2", preexec_fn=enter)
                self.assertIn(done.code, expected, done.err)
                if done.code == 0:
                    self.assertIn("straight to the file", done.out)
                    self.assertTrue(filecmp.cmp(free, out, shallow=False))
        # A search that is repeated makes lists first; they do not fit.
        for megabytes, expected in ((100, (0, 4)), (150, (0, 4)), (250, (0, 4)), (400, (0,))):
            with self.subTest(megabytes=megabytes, repeat=2), cli_case.memory_group(megabytes << 20) as enter:
                done = cli_case.run("search", path, "-r", "0.2", "-o", out, "-f", "-T", "2", "--repeat", "2",
                                    preexec_fn=enter)
                self.assertIn(done.code, expected, done.err)
                if done.code == 0:
                    self.assertRegex(done.err, "allowed are .* straight to the file instead")
                    self.assertTrue(filecmp.cmp(free, out, shallow=False))


class LittleToRunIn(CliCase):
    """Threads that cannot be made, and little stack: an answer, or exit 4 with the reason."""

    def setUp(self):
        super().setUp()
        self.input = self.scene("block", 3000)

    def check(self, expected, **options):
        done = cli_case.run("search", self.input, "-r", "0.2", "-q", "-T", "4", **options)
        self.assertIn(done.code, expected, done.err)
        if done.code == 4:
            self.assertRegex(done.err, "^vdb_nns: error: [^\n]*(threads|memory)[^\n]*\n$")
        return done

    def test_no_more_processes(self):
        if os.geteuid() != 0:
            self.skipTest("only root can become another user, to whom limits of processes apply")
        program = shutil.copy(cli_case.BINARY, self.folder)
        os.chmod(self.folder, 0o755)
        for processes in (1, 2, 3, 5, 8, 12):
            with self.subTest(processes=processes):
                with unittest.mock.patch.object(cli_case, "BINARY", program):
                    done = self.check((0, 4), user=54321, preexec_fn=lambda: resource.setrlimit(
                        resource.RLIMIT_NPROC, (processes, processes)))
                if processes == 1:
                    self.assertEqual(done.code, 4)
                    self.assertIn("makes no more threads", done.err)

    def test_little_address_space(self):
        for megabytes in (*range(70, 100, 10), *range(100, 130), *range(130, 240, 10)):
            with self.subTest(megabytes=megabytes):  # 127: not even the libraries fit
                self.check((0, 4, 127), preexec_fn=limit_address_space(megabytes * MB))

    def test_little_stack(self):
        limit = {"preexec_fn": lambda: resource.setrlimit(resource.RLIMIT_STACK, (64 << 10, 64 << 10))}
        self.check((0,), **limit)
        self.succeeds("info", self.npy("points.npy", np.random.default_rng(1).random((20000, 3))), **limit)


class WideCells(CliCase):
    def test_masks_that_do_not_fit_are_made_in_cells_of_the_radius(self):
        path = self.scene("spray", 2000000)
        search = ("search", path, "--encoding", "mask", "--checksum", "-T", "2", "--device", "cpu", "--json", self.path("r.json"), "-f")
        free = self.report("search", path, "--encoding", "mask", "--checksum", "-T", "2")
        self.assertGreater(free["grid"]["cell_size"], 2 * free["radius"]["world"])

        def code(size, *args):
            return cli_case.run(*search, *args, preexec_fn=limit_address_space(size * MB)).code

        size, enough = 0, 3000  # where the masks of wide cells do not fit, and where they do
        while enough - size > 10:
            middle = (size + enough) // 2
            if code(middle, "--cell-size", "3") == 0:
                enough = middle
            else:
                size = middle
        size -= 30 # what a process maps is not the same each time; between the two kinds of masks lie some 80 MB
        self.assertEqual((code(size, "--cell-size", "3"), code(size, "--cell-size", "1")), (4, 0))
        done = self.succeeds(*search, preexec_fn=limit_address_space(size * MB))
        self.assertRegex(done.err, "the grid is made again in cells of the radius")
        with open(self.path("r.json")) as file:
            found = json.load(file)
        self.assertEqual(found["result"], free["result"])
        self.assertLess(found["grid"]["cell_size"], 1.01 * free["radius"]["world"])
        self.assertLess(found["memory"]["list_bytes"], free["memory"]["list_bytes"] / 2)
