"""Flags: what is accepted, what is refused, what is printed where."""
import json
import re
import struct

from cli_case import CliCase, run

REPORT_KEYS = {
    "": ["schema", "version", "command", "input", "radius", "grid", "device", "devices", "plan", "result", "estimate",
         "memory", "seconds"],
    "input": ["path", "grid", "points", "nonfinite", "voxel_size", "codec", "transform"],
    "radius": ["world", "voxels"],
    "grid": ["cell_size", "leaves", "cells", "bytes"],
    "device": ["kind", "name", "budget_bytes", "threads"],
    "plan": ["in_core", "encoding", "blocks", "largest_block_cells", "device_particles", "cpu_particles",
             "boundary_leaves", "estimated_pairs", "estimated_bytes", "candidate_tests"],
    "result": ["pairs", "min", "mean", "max", "isolated", "checksum"],
    "estimate": ["actual_pairs", "relative_error", "block_error_p50", "block_error_p99", "overflows", "retries"],
    "memory": ["peak_rss_bytes", "grid_bytes", "list_bytes", "device_peak_bytes"],
    "seconds": ["read", "grid", "estimate", "plan", "search", "collect", "write", "total", "first"],
}


class Help(CliCase):
    def test_help_is_on_stdout(self):
        for args in (["--help"], ["-h"], ["search", "--help"], ["scene", "--help"]):
            done = self.succeeds(*args)
            self.assertIn("Usage", done.out)
            self.assertEqual(done.err, "")
        self.assertIn("--encoding", run("search", "--help").out)
        for args in ([], ["help"], ["help", "help"]):
            self.assertEqual(run(*args), run("--help"), args)
        for command in ("search", "bench"):
            self.assertEqual(run("help", command), run(command, "--help"))
        self.assertIn("two_sources", run("scene", "--help").out)

    def test_version_names_build(self):
        done = self.succeeds("--version")
        self.assertRegex(done.out, r"^vdb_nns \d+\.\d+\.\d+")
        self.assertIn("CUDA", done.out)

    def test_markdown_has_every_flag_of_help(self):
        table = self.succeeds("--help-markdown").out
        for command in ("search", "scene", "verify", "bench", "convert", "info"):
            section = table.split(f"### `vdb_nns {command}`")[1].split("###")[0]
            flags = re.findall(r"--[a-z][a-z-]*", run(command, "--help").out)
            self.assertGreater(len(flags), 4)
            for flag in set(flags) - {"--help", "--scene"}:
                self.assertIn(flag, section, command)


class BadFlags(CliCase):
    def test_unknown_command_or_flag(self):
        self.fails(2, "search", says="IN is required")
        # Each word in the order typed, and the name that is nearest to one of them.
        for words, suggestion in ((["serch", "a.vdb"], "search"), (["verfy"], "verify"), (["scenes"], "scene"),
                                  (["search", "a.vdb", "--raduis", "1", "b", "--zzz"], "--radius"),
                                  (["search", "--forec", "a.vdb", "b.vdb"], "--force"),
                                  (["search", "a.vdb", "--encod", "mask"], "--encoding"),
                                  (["info", "a.vdb", "--jsno=x"], "--json"), (["frobnicate"], None),
                                  (["info", "a.vdb", "-r", "1"], None)):
            message = self.fails(2, *words, says="does not know").err
            if suggestion:
                self.assertIn(f"did you mean '{suggestion}'?", message)
            else:
                self.assertNotIn("did you mean", message)
        self.assertIn("vdb_nns search does not know --raduis b --zzz 1;",
                      self.fails(2, "search", "a.vdb", "--raduis", "b", "--zzz", "1").err)
        self.assertIn("does not know --raduis b; did you", self.fails(2, "search", "--raduis", "a", "b").err)
        for words in (["help", "serch"], ["serch", "--help"]):
            self.fails(2, *words, says="did you mean 'search'?")

    def test_radius(self):
        path = self.scene()
        for text in ("0", "-1", "-0.0", "nan", "inf", "-inf", "text", "", " ", "1x", "1e999", "1e-999", "0x", "1,5"):
            self.fails(2, "search", path, "-r", text, says="--radius")

    def test_values(self):
        path = self.scene()
        for args in (["--threads", "-1"], ["--threads", "two"], ["--threads", "1.5"], ["--threads", "1000000"],
                     ["--host-memory", "0"], ["--host-memory", "lots"], ["--host-memory", "4 G"],
                     ["--host-memory", "4Q"], ["--host-memory", "-1G"], ["--cell-size", "4.5"], ["--cell-size", "0"],
                     ["--cell-size", "0.2"], ["--encoding", "bits"], ["--lists", "weights"],
                     ["--attributes", "density"], ["--attributes", ""], ["--prefix", "a b"], ["--repeat", "0"],
                     ["--nonfinite", "keep"], ["--progress", "maybe"], ["--device", "sim:0"],
                     ["--device", "tpu"], ["--device", "cuda:x"], ["--device", "cudax"], ["-o", ""], ["-q", "-v"]):
            self.fails(2, "search", path, "-r", "0.2", *args, says=args[0] if args[0] != "-q" else ())

    def test_limits_are_named(self):
        path = self.scene()
        for threads in ("-1", "1025", "two"):
            self.fails(2, "search", path, "-T", threads, says=["--threads", threads, "0 to 1024"])
        for command in ("search", "plan", "bench"):
            self.fails(4, command, path, "--host-memory", "64", says=["--host-memory", "64 bytes", "MiB before", "4G"])
            message = self.fails(4, command, path, "--host-memory", "2MB", says=["2000000 bytes", "the program itself"]).err
            for flag in re.findall("--[a-z-]+", message):
                self.assertIn(flag, run(command, "--help").out)

    def test_values_that_work(self):
        path = self.scene()
        pairs = set()
        for args in (["-T2"], ["-T", "0"], ["--host-memory", "1.5GB"], ["--host-memory", "1GiB"],
                     ["--host-memory", "2000000000"], ["--host-memory", "1T"], ["--cell-size", "auto"],
                     ["--cell-size", "1"], ["--cell-size", "0.5"], ["--cell-size", "0.333"], ["--cell-size", "1/3"],
                     ["--device", "cpu"], ["--device", "auto"], ["--nonfinite", "fail"], ["--repeat", "3"]):
            pairs.add(self.report("search", path, *args)["result"]["pairs"])
        self.assertEqual(len(pairs), 1)

    def test_reach_follows_cell_size(self):
        path = self.scene()
        sizes = [self.report("search", path, "-r", 0.25, "--cell-size", ratio)["grid"]["cell_size"]
                 for ratio in ("1", "0.5", "0.333")]
        for size, reach in zip(sizes, (1, 2, 3)):
            self.assertGreaterEqual(size, 0.25 / reach)
            self.assertLess(size, 0.25 / reach * 1.001)

    def test_cuda_is_refused_with_a_reason(self):
        path = self.scene()
        for device in ("cuda", "cuda:0"):
            self.fails(5, "search", path, "-r", "0.2", "--device", device, says=[device, "CUDA", "--device cpu"])

    def test_contradictions(self):
        path = self.scene()
        array = self.npy("a.npy", [[0, 0, 0], [1, 0, 0]])
        out = self.path("x.npz")
        self.fails(2, "search", path, "-o", out, "--encoding", "none", says="--encoding none")
        self.fails(2, "search", array, "-r", "1", "-o", self.path("x.bgeo"), says="x.bgeo")
        self.fails(2, "search", path, "-o", out, "-o", out, says="two outputs")
        self.fails(2, "search", path, "-o", out, "-o", self.path("./x.npz"), says="two outputs")
        self.fails(2, "search", path, "-o", out, "--json", out, says="two outputs")
        self.fails(2, "search", path, "--json", path, "-f", says="input")
        self.fails(2, "search", array, "-r", "1", "-g", "points", says="grid")


class Summary(CliCase):
    def test_summary_and_quiet(self):
        path = self.scene()
        done = self.succeeds("search", path, "-r", "0.2")
        self.assertEqual(done.err, "")
        for label in ("particles", "radius", "pairs", "neighbors", "isolated", "cells", "time", "search"):
            self.assertRegex(done.out, rf"(?m)^ *{label} ")
        self.assertEqual(self.succeeds("search", path, "-r", "0.2", "-q"), (0, "", ""))
        self.assertIn("exact", self.succeeds("search", path, "-r", "0.2", "-v").err)

    def test_suggested_radius_is_used_and_said(self):
        path = self.scene()
        suggested = self.report("info", path)["suggested_radius"]
        done = self.succeeds("search", path, "--json", "-")
        self.assertIn("suggests the radius", done.err)
        self.assertEqual(json.loads(done.out)["radius"]["world"], suggested)
        self.assertEqual(self.succeeds("search", path, "-q").err, "")
        self.fails(2, "search", self.npy("a.npy", [[0, 0, 0]]), says=["a.npy", "-r"])

    def test_a_bad_suggested_radius_is_the_files(self):
        path = self.scene()
        content, good = self.bytes(path), struct.pack("<d", self.report("info", path)["suggested_radius"])
        at = content.index(good, content.index(b"suggested_radius"))
        for bad, shown in ((-1.0, "-1"), (0.0, "0"), (float("inf"), "inf"), (float("nan"), "nan")):
            bad = self.text("bad.vdb", content[:at] + struct.pack("<d", bad) + content[at + 8:])
            for command in ("search", "plan", "bench"):
                self.fails(2, command, bad, says=["bad.vdb", f"the file's suggested_radius is {shown}", "-r"])
            self.succeeds("search", bad, "-r", "0.2", "-q")

    def test_report_has_all_keys(self):
        report = self.report("search", self.scene(), "--checksum", "-o", self.path("x.npz"))
        for parent, keys in REPORT_KEYS.items():
            part = report[parent] if parent else report
            self.assertEqual([key for key in keys if key not in part], [], parent)
        self.assertEqual((report["schema"], report["command"]), (1, "search"))
        self.assertEqual(set(report["seconds"]["first"]), {"grid", "search"})
        self.assertEqual({"kind", "name", "budget_bytes", "peak_bytes", "blocks", "particles", "busy_seconds"}
                         - set(report["devices"][0]), set())
        self.assertEqual(report["device"]["kind"], "cpu")
        self.assertRegex(report["result"]["checksum"], r"^[0-9a-f]{16}$")
        self.assertEqual(len(report["input"]["voxel_size"]), 3)
        self.assertEqual([len(row) for row in report["input"]["transform"]], [4] * 4)
        self.assertEqual(report["plan"]["encoding"], "index")
        self.assertGreater(report["seconds"]["write"], 0)
        self.assertIsNone(report["seconds"]["estimate"])

    def test_report_of_an_array(self):
        report = self.report("search", self.npy("a.npy", [[0, 0, 0], [1, 0, 0]]), "-r", "1")
        self.assertIsNone(report["input"]["voxel_size"])
        self.assertIsNone(report["radius"]["voxels"])
        self.assertIsNone(report["result"]["checksum"])
        self.assertIsNone(report["seconds"]["write"])
        self.assertEqual(report["plan"]["encoding"], "none")
        self.assertEqual(report["result"]["pairs"], 2)  # a distance of exactly the radius counts

    def test_checksum_does_not_depend_on_the_encoding(self):
        path = self.scene()
        sums = {self.report("search", path, "--checksum", "--encoding", e)["result"]["checksum"]
                for e in ("index", "mask", "none")}
        sums.add(self.report("search", path, "--checksum")["result"]["checksum"])
        self.assertEqual(len(sums), 1)
        self.assertIsNone(self.report("search", path, "--encoding", "none")["result"]["checksum"])
        self.assertIn(self.report("search", path, "--encoding", "index")["result"]["checksum"], sums)

    def test_checksum_is_the_documented_sum(self):
        report = self.report("search", self.npy("a.npy", [[0, 0, 0], [1, 0, 0], [5, 0, 0]]), "-r", "1", "--checksum")
        mask = 2 ** 64 - 1

        def mix64(z):
            z = ((z ^ z >> 30) * 0xbf58476d1ce4e5b9) & mask
            z = ((z ^ z >> 27) * 0x94d049bb133111eb) & mask
            return z ^ z >> 31
        self.assertEqual(report["result"]["checksum"], f"{(mix64(1) + mix64(1 << 32)) & mask:016x}")

    def test_json_file_obeys_force(self):
        path, target = self.scene(), self.path("report.json")
        done = self.succeeds("search", path, "--json", target)
        self.assertIn("pairs", done.out)
        with open(target) as file:
            self.assertEqual(json.load(file)["command"], "search")
        self.fails(2, "search", path, "--json", target, says="report.json")
        self.succeeds("search", path, "--json", target, "-f", "-q")
        self.fails(6, "search", path, "--json", self.path("no/such/report.json"), says="report.json")

    def test_progress(self):
        path = self.scene()
        lines = self.succeeds("search", path, "-r", "0.2", "--progress", "always").err.splitlines()
        numbers = [int(re.fullmatch(r"PROGRESS (\d+)%", line).group(1)) for line in lines]
        self.assertEqual(numbers, sorted(set(numbers)))
        self.assertEqual(numbers[-1], 100)
        self.assertEqual(self.succeeds("search", path, "-r", "0.2", "--progress", "auto").err, "")


class Info(CliCase):
    def test_info(self):
        path = self.scene()
        self.assertIn("suggested", self.succeeds("info", path).out)
        info = self.report("info", path)
        for key in ("points", "voxel_size", "codec", "transform", "bbox", "attributes", "suggested_radius"):
            self.assertIn(key, info)
        self.assertEqual(info["grid"], "points")
        self.assertEqual(info["attributes"][0], {"name": "P", "type": "vec3s", "codec": "null"})
        low, high = info["bbox"]
        self.assertTrue(all(a < b for a, b in zip(low, high)))

    def test_info_of_an_array(self):
        info = self.report("info", self.npy("a.npy", [[0, 1, 2], [3, 4, 5], [float("nan"), 0, 0]]))
        self.assertEqual((info["points"], info["nonfinite"]), (3, 1))
        self.assertEqual(info["bbox"], [[0, 1, 2], [3, 4, 5]])
        for key in ("voxel_size", "suggested_radius", "grid"):
            self.assertIsNone(info[key])


class Scene(CliCase):
    def test_counts_and_names(self):
        for count in ("2000", "2k", "0.002M", "2e3"):
            out = self.path(f"s{count}.vdb")
            done = self.succeeds("scene", "spray", "-n", count, "-o", out)
            self.assertRegex(done.out, r"(?m)^radius +[0-9.e-]+ suggested$")
            self.assertEqual(self.report("info", out)["points"], 2000)
        out = self.path("x.vdb")
        for args in (["nonsense", "-n", "10"], ["block", "-n", "0"], ["block", "-n", "1.5"], ["block", "-n", "-4"],
                     ["block", "-n", "4Q"], ["block", "-n", "9G"], ["block"], ["block", "-n", "10", "--offset", "4"],
                     ["block", "-n", "10", "--codec", "zip"], ["block", "-n", "10", "--spacing", "0"]):
            self.fails(2, "scene", *args, "-o", out)
        self.fails(2, "scene", "block", "-n", "10", "-o", self.path("x.npy"), says="x.npy")
        self.fails(2, "scene", "block", "-n", "10")

    def test_tiny_spacing(self):
        path = self.scene("block", 1000, "--spacing", "1e-7")
        self.assertEqual(self.report("info", path)["voxel_size"], [2e-7] * 3)

    def test_same_seed_same_bytes_but_the_uuid(self):
        files = []
        for name, seed in (("a", 1), ("b", 1), ("c", 2)):
            self.succeeds("scene", "clusters", "-n", "3k", "--seed", seed, "-o", self.path(name + ".vdb"), "-q")
            with open(self.path(name + ".vdb"), "rb") as file:
                data = file.read()
            files.append(data[:21] + data[57:])
        self.assertEqual(files[0], files[1])
        self.assertNotEqual(files[0], files[2])

    def test_every_scene_can_be_searched(self):
        names = re.findall(r"(?m)^  ([a-z_]+) ", run("scene", "--help").out.split("Scenes:")[1])
        self.assertEqual(len(names), 11)
        for name in names:
            self.assertEqual(self.succeeds("search", self.scene(name, 1000), "-q").code, 0)
