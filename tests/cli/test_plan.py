"""The dry run: what would run where, without running it."""
import json
import os
import re
import xml.etree.ElementTree as ElementTree

import numpy as np

from cli_case import CliCase, run

PLAN_KEYS = ["in_core", "encoding", "blocks", "largest_block_cells", "device_particles", "cpu_particles",
             "boundary_leaves", "estimated_pairs", "estimated_bytes", "measure_bytes", "candidate_tests", "boundary", "tree_nodes",
             "tree_levels", "predicted_seconds", "lower_bound_seconds", "blocks_list"]
BLOCK_KEYS = ["cells", "origin", "leaves", "particles", "halo_particles", "boundary_queries", "expected_pairs",
              "candidate_tests", "bytes", "executor", "start_seconds", "end_seconds"]


def without_measures(report):
    """What two runs have in common."""
    report = json.loads(json.dumps(report))
    del report["seconds"], report["memory"]["peak_rss_bytes"]
    return report


class PlanCase(CliCase):
    def plan(self, path, *args):
        report = self.report("plan", path, "-q", *args)
        self.check(report)
        return report

    def check(self, report):
        """What holds for every plan."""
        plan, blocks = report["plan"], report["plan"]["blocks_list"]
        points = report["input"]["points"] - report["input"]["nonfinite"]
        self.assertEqual(len(blocks), plan["blocks"])
        self.assertEqual(sum(b["particles"] for b in blocks), points)
        self.assertEqual(plan["device_particles"] + plan["cpu_particles"], points)
        self.assertEqual(sum(b["candidate_tests"] for b in blocks), plan["candidate_tests"])
        self.assertAlmostEqual(sum(b["expected_pairs"] for b in blocks), plan["estimated_pairs"],
                               delta=1e-6 * plan["estimated_pairs"] + 1e-6)
        self.assertEqual(max([b["cells"] for b in blocks], default=0), plan["largest_block_cells"])
        self.assertLessEqual(plan["lower_bound_seconds"], plan["predicted_seconds"] * (1 + 1e-9))
        self.assertEqual(report["devices"][-1]["kind"], "cpu")
        for number, device in enumerate(report["devices"]):
            name = "cpu" if device["kind"] == "cpu" else f"sim:{number}"
            own = [b for b in blocks if b["executor"] == name]
            self.assertEqual(len(own), device["blocks"], name)
            if name != "cpu":
                self.assertLessEqual(device["peak_bytes"], device["budget_bytes"])
                self.assertLessEqual(device["busy_seconds"], plan["predicted_seconds"] * (1 + 1e-9))
        self.assertEqual(sum(d["particles"] for d in report["devices"]), points)
        cubes = {}
        for block in blocks:
            self.assertEqual([key for key in BLOCK_KEYS if key not in block], [])
            self.assertEqual(len(block["origin"]), 3)
            self.assertLessEqual(block["start_seconds"], block["end_seconds"])
            # Parts of a leaf have the boundary queries of all of it.
            cubes.setdefault((block["cells"], *block["origin"]), []).append(block)
        for parts in cubes.values():
            self.assertLessEqual(parts[0]["boundary_queries"], sum(b["particles"] for b in parts))


class Report(PlanCase):
    def test_keys(self):
        from test_usage import REPORT_KEYS
        report = self.plan(self.scene(), "--device", "sim")
        for parent, keys in REPORT_KEYS.items():
            part = report[parent] if parent else report
            if parent != "result":
                self.assertEqual([key for key in keys if key not in part], [], parent)
        self.assertEqual([key for key in PLAN_KEYS if key not in report["plan"]], [])
        self.assertEqual((report["schema"], report["command"]), (1, "plan"))
        self.assertIsNone(report["result"])
        self.assertEqual(report["device"]["kind"], "sim")
        self.assertEqual(report["memory"]["device_peak_bytes"], report["devices"][0]["peak_bytes"])
        seconds = report["seconds"]
        for key in ("read", "grid", "estimate", "plan", "total"):
            self.assertGreaterEqual(seconds[key], 0)
        self.assertEqual([seconds[key] for key in ("search", "collect", "checksum", "write")], [None] * 4)

    def test_cpu_alone(self):
        path = self.scene("spray", 5000)
        for args in ([], ["--device", "cpu"], ["--device", "auto", "--device-memory", "1M", "--block-size", "8"]):
            plan = self.plan(path, *args)["plan"]
            self.assertEqual((plan["blocks"], plan["tree_nodes"], plan["tree_levels"]), (1, 1, 1))
            self.assertEqual((plan["in_core"], plan["device_particles"], plan["cpu_particles"]), (True, 0, 5000))
            self.assertEqual(plan["blocks_list"][0]["executor"], "cpu")
        report = self.plan(path)
        self.assertEqual([d["kind"] for d in report["devices"]], ["cpu"])
        self.assertEqual(report["device"]["kind"], "cpu")
        self.assertIsNone(report["memory"]["device_peak_bytes"])

    def test_same_again(self):
        path = self.scene("clusters", 20000)
        args = ["--device", "sim:2", "--device-memory", "300K"]
        first = self.plan(path, *args)
        self.assertEqual(without_measures(self.plan(path, *args)), without_measures(first))
        threads = {json.dumps(self.plan(path, *args, "-T", n)["plan"]["estimated_pairs"]) for n in (1, 2)}
        self.assertEqual(len(threads), 1)

    def test_estimate_is_near_the_truth(self):
        path = self.scene("block", 20000)
        pairs = self.report("search", path, "-q")["result"]["pairs"]
        for estimator, error in (("expected", 0.05), ("sampled", 0.05), ("counted", 0), ("montecarlo", 0.5)):
            plan = self.plan(path, "--estimator", estimator)["plan"]
            self.assertLessEqual(abs(plan["estimated_pairs"] - pairs), error * pairs, estimator)
            self.assertEqual(plan["estimator"], estimator)
        self.assertEqual(self.plan(path, "--estimator", "fixed")["plan"]["estimated_pairs"], 64 * 20000)

    def test_tests_are_those_of_the_search(self):
        path = self.scene("spray", 5000)
        search, plan = self.report("search", path, "-q"), self.plan(path)
        self.assertEqual(plan["plan"]["candidate_tests"], search["plan"]["candidate_tests"])
        for key in ("radius", "grid", "input"):
            self.assertEqual(plan[key], search[key])

    def test_arrays_and_particles_that_are_not_finite(self):
        path = self.npy("a.npy", [[0, 0, 0], [1, 0, 0], [float("nan"), 0, 0], [50, 0, 0]])
        report = self.plan(path, "-r", "1", "--device", "sim")
        self.assertEqual((report["input"]["points"], report["input"]["nonfinite"]), (4, 1))
        self.fails(1, "plan", path, "-r", "1", "--nonfinite", "fail", says="1 of 4")
        self.fails(2, "plan", path, says=["a.npy", "-r"])

    def test_no_particles(self):
        path = self.npy("empty.npy", [[float("nan")] * 3])
        for args in ([], ["--device", "sim:2", "--device-memory", "1"], ["--svg", self.path("empty.svg")]):
            plan = self.plan(path, "-r", "1", *args)["plan"]
            self.assertEqual((plan["blocks"], plan["predicted_seconds"]), (0, 0))
        ElementTree.parse(self.path("empty.svg"))


class Budgets(PlanCase):
    def test_in_core_needs_no_tree(self):
        path = self.scene("spray", 20000)
        need = self.plan(path, "--device", "sim")["plan"]["estimated_bytes"]
        for memory in ("3GiB", need):
            plan = self.plan(path, "--device", "sim", "--device-memory", memory)["plan"]
            self.assertEqual((plan["in_core"], plan["blocks"], plan["tree_nodes"]), (True, 1, 1))
            self.assertEqual(plan["blocks_list"][0]["bytes"], need)
            self.assertEqual(plan["device_particles"], 20000)
        plan = self.plan(path, "--device", "sim", "--device-memory", need - 1)["plan"]
        self.assertFalse(plan["in_core"])
        self.assertGreater(plan["blocks"], 1)
        self.assertGreater(plan["tree_nodes"], 1)

    def test_budgets(self):
        for scene in ("spray", "block", "clusters"):
            path = self.scene(scene, 20000)
            for encoding in ("mask", "index"):
                need = self.plan(path, "--device", "sim", "--encoding", encoding)["plan"]["estimated_bytes"]
                blocks = 0
                for share, device in ((1, "sim"), (0.1, "sim"), (0.1, "sim:2"), (0.01, "sim"), (0.0001, "sim")):
                    memory = max(1, int(need * share))
                    plan = self.plan(path, "--device", device, "--device-memory", memory,
                                     "--encoding", encoding)["plan"]
                    self.assertEqual(plan["encoding"], encoding)
                    if not plan["in_core"]:
                        for block in plan["blocks_list"]:
                            if block["executor"] != "cpu":
                                self.assertLessEqual(block["bytes"], memory // 3)
                    if plan["too_large_queries"] == 0:  # a leaf of which no part fits is not cut
                        self.assertGreaterEqual(plan["blocks"], blocks)
                        blocks = plan["blocks"] if device == "sim" else blocks
                # Below a leaf the CPU runs all.
                self.assertEqual(plan["device_particles"], 0, (scene, encoding))

    def test_two_devices(self):
        report = self.plan(self.scene("spray", 20000), "--device", "sim:2", "--device-memory", "200K")
        self.assertEqual([d["kind"] for d in report["devices"]], ["sim", "sim", "cpu"])
        self.assertTrue(all(d["blocks"] > 0 for d in report["devices"][:2]))
        self.assertEqual(report["devices"][0]["budget_bytes"], 200 * 1024)

    def test_block_size(self):
        path = self.scene("block", 50000)
        blocks = []
        for cells in (8, 16, 32, 64):
            plan = self.plan(path, "--device", "sim", "--block-size", cells)["plan"]
            self.assertLessEqual(plan["largest_block_cells"], cells)
            self.assertFalse(plan["in_core"])
            for block in plan["blocks_list"]:
                self.assertEqual([x % block["cells"] for x in block["origin"]], [0, 0, 0])
            blocks.append(plan["blocks"])
        self.assertEqual(blocks, sorted(blocks, reverse=True))

    def test_boundary_modes(self):
        path = self.scene("block", 50000)
        seconds = {}
        for mode in ("cpu", "halo", "auto"):
            plan = self.plan(path, "--device", "sim", "--block-size", "16", "--boundary", mode)["plan"]
            seconds[mode] = plan["predicted_seconds"]
            if mode != "auto":
                self.assertEqual(plan["boundary"], mode)
            if plan["boundary"] == "halo":
                self.assertEqual(plan["boundary_leaves"], 0)
                self.assertGreater(max(b["halo_particles"] for b in plan["blocks_list"]), 0)
            else:
                self.assertGreater(plan["boundary_leaves"], 0)
                self.assertEqual(max(b["halo_particles"] for b in plan["blocks_list"]), 0)
        self.assertEqual(seconds["auto"], min(seconds.values()))

    def test_faster_devices_end_sooner(self):
        path = self.scene("block", 50000)
        ends = [self.plan(path, "--device", "sim", "--sim", spec)["plan"]["predicted_seconds"]
                for spec in ("rate=1Gtests/s", "rate=2G", "gtx780", "h200")]
        self.assertEqual(ends, sorted(ends, reverse=True))
        self.assertEqual(len(set(ends)), 4)


class Measures(PlanCase):
    """What measures take is what a search needs for them."""

    def points_alone(self, path, *args):
        """What the search has beside grid, counts and measures, by its own words."""
        err = self.fails(4, "search", path, *args, "--host-memory", "60MB", says="points alone need").err
        return int(re.search("points alone need ([0-9]+) bytes", err)[1])

    def test_bytes(self):
        path, count = self.scene(), 2000
        none = self.plan(path)["plan"]
        self.assertIsNone(none["measure_bytes"])
        for names, each in (("count", 0), ("density", 8 + 16), ("normal,isolated", 12 + 1 + 16), ("density,pca", 8 + 73 + 16)):
            plan = self.plan(path, "--attributes", names)["plan"]
            self.assertEqual(plan["measure_bytes"], each * count, names)
            self.assertEqual(plan["estimated_bytes"], none["estimated_bytes"] + each * count)
            written = self.plan(path, "--attributes", names, "-o", self.path("x.vdb"), "-o", self.path("x.npz"))["plan"]
            self.assertGreaterEqual(written["measure_bytes"], plan["measure_bytes"] + (16 << 20) + 8 * count)
            others = self.plan(path, "--attributes", names, "-o", self.path("x.ply"), "-o", self.path("x.npz"))["plan"]
            self.assertEqual(others, plan)
        self.assertEqual(sorted(os.listdir(self.folder)), ["block.vdb"])
        values = {"mass": np.ones(count), "v": np.ones((count, 3), np.float32), "kind": np.ones(count, np.int32)}
        np.savez(self.path("v.npz"), positions=np.random.default_rng(1).random((count, 3)), **values)
        args = (self.path("v.npz"), "-r", "0.1")
        # Positions of doubles, a mass, an attribute as it is read, and as it is summed.
        plan = self.plan(*args, "--attributes", "density,average:v", "--mass-attribute", "mass")["plan"]
        self.assertEqual(plan["measure_bytes"], (8 + 12 + 32 + 8 + 12 + 32) * count)
        # A new grid: places, numbers and P beside the values.
        new, plain = (self.plan(*args, "--attributes", "density", *out)["plan"] for out in (["-o", self.path("x.vdb")], []))
        self.assertEqual(new["measure_bytes"], plain["measure_bytes"] + (16 << 20) + (4 + 8 + 36) * count)
        queries = self.report("plan", *args, "--attributes", "average:kind", "--queries", path)["plan"]
        self.assertEqual(queries["measure_bytes"], 4 * count + (4 + 8) * count + 32 * 2 * count)
        text = self.succeeds("plan", path, "--attributes", "density,pca").out
        self.assertRegex(text, r"(?m)^measures +[0-9.]+ MiB of host memory besides$")
        self.assertNotIn("measures ", self.succeeds("plan", path).out)
        on_device = self.plan(path, "--attributes", "density", "--device", "sim", "--encoding", "index")["plan"]
        self.assertEqual(on_device["estimated_bytes"], on_device["blocks_list"][0]["bytes"] + 24 * count)

    def test_a_search_needs_them(self):
        path, count, names = self.scene("block", 400000), 400000, "density,pca,normal"
        for output in (["--attributes-output", self.path("x.npz")], ["-o", self.path("x.vdb")]):
            planned = self.plan(path, "--attributes", names, *(output if output[0] == "-o" else []))
            search = [path, "--attributes", names, *output, "-T", "2", "-f"]
            measures, grid = planned["plan"]["measure_bytes"], planned["grid"]["bytes"]
            need = self.points_alone(*search) + grid + 8 * count + 16 * planned["grid"]["leaves"]
            with self.subTest(output):
                err = self.fails(4, "search", *search, "--host-memory", need + measures * 9 // 10, says="measures need").err
                if output[0] != "-o":
                    self.assertEqual(int(re.search("measures need ([0-9]+) bytes", err)[1]), grid + measures)
                bound = need + measures * 11 // 10
                self.assertLessEqual(self.report("search", *search, "-q", "--host-memory", bound)["memory"]["peak_rss_bytes"], bound)

    def test_flags(self):
        missing = self.path("missing.vdb")
        for args, says in ((["--attributes", "densty"], "did you mean 'density'?"), (["--kernel", "poly6"], "--kernel is about"),
                           (["--mass-attribute", "m"], "--mass-attribute is about"), (["--min-neighbors", "3"], "--min-neighbors is about"),
                           (["-o", self.path("x.vdb")], "name some by --attributes"),
                           (["--attributes", "density", "-o", self.path("x.txt")], "use .npz for lists")):
            self.fails(2, "plan", missing, *args, says=says)
        path = self.scene()
        self.fails(2, "plan", path, "--attributes", "average:vv", says="'vv'")
        self.fails(2, "plan", path, "--attributes", "average:P", says="'P' is the position")
        kept = self.text("x.vdb", "kept")
        self.plan(path, "--attributes", "density", "-o", kept)
        self.assertEqual(self.bytes(kept), b"kept")


class Flags(PlanCase):
    def test_good_values(self):
        path = self.scene()
        for args in (["--device", "sim:16"], ["--device-memory", "2.5GB"], ["--device-memory", "100T"],
                     ["--block-size", "2048"], ["--block-size", "8"],
                     ["--sim", "gtx780"], ["--sim", "h200,memory=3GiB"], ["--sim", "pcie=12GB/s,rate=2.5Gtests/s"],
                     ["--sim", "up=6,down=500MB/s"], ["--sim", "rate=2.5e9"], ["--sim", "rate=2500M"],
                     ["--sim", "latency=20us,slots=1"], ["--sim", "latency=2e-5s,slots=16"], ["--sim", "latency=1ms"],
                     ["--sim", "memory=1M"]):
            self.plan(path, *([] if args[0] == "--device" else ["--device", "sim"]), *args)

    def test_sim_spec_reaches_the_device(self):
        path = self.scene()
        device = self.plan(path, "--device", "sim", "--sim", "h200,memory=3GiB")["devices"][0]
        self.assertEqual((device["name"], device["budget_bytes"]), ("simulated H200", 3 << 30))
        self.assertEqual(self.plan(path, "--device", "sim", "--sim", "gtx780")["devices"][0]["budget_bytes"], 3 << 30)
        self.assertEqual(self.plan(path, "--device", "sim", "--sim", "h200")["devices"][0]["budget_bytes"], 141 * 10**9)
        both = ["--sim", "memory=3GiB", "--device-memory", "1M"]
        self.assertEqual(self.plan(path, "--device", "sim", *both)["devices"][0]["budget_bytes"], 1 << 20)
        latency = [self.plan(path, "--device", "sim", "--sim", f"latency={text}")["plan"]["predicted_seconds"]
                   for text in ("1ms", "2ms", "0.002s", "2000us")]
        self.assertAlmostEqual(latency[1] - latency[0], 1e-3)
        self.assertAlmostEqual(latency[1], latency[2])
        self.assertAlmostEqual(latency[1], latency[3])

    def test_bad_values(self):
        path = self.scene()
        sim = ["--device", "sim"]
        for args in (["--device", "tpu"], ["--device", "sim:0"], ["--device", "sim:17"], ["--device", "sim:-1"],
                     ["--device", "sim:"], ["--device", "simx"], ["--device", "cuda:x"], ["--device", ""],
                     ["--device-memory", "0"], ["--device-memory", "-1G"], ["--device-memory", "nan"],
                     ["--device-memory", "lots"], ["--device-memory", "4Q"], ["--device-memory", ""],
                     ["--boundary", "gpu"], ["--boundary", ""], ["--estimator", "guess"], ["--estimator", ""],
                     ["--block-size", "0"], ["--block-size", "4"], ["--block-size", "48"], ["--block-size", "4096"],
                     ["--block-size", "-16"], ["--block-size", "16.5"], ["--block-size", "big"], ["--block-size", ""],
                     ["--encoding", "none"], ["--encoding", "bits"], ["--nonfinite", "keep"], ["--cell-size", "5"],
                     ["--host-memory", "0"], ["--threads", "x"]):
            device = [] if args[0] == "--device" else sim
            self.fails(2, "plan", path, "-r", "0.2", *device, *args, says=args[0])

    def test_bad_specs(self):
        path = self.scene()
        for spec in ("", ",", "gtx780,", "gtx9999", "pcie", "pcie=12,h200", "speed=3", "pcie=", "pcie=0", "pcie=-12",
                     "pcie=nan", "pcie=inf", "pcie=12km/h", "pcie=1e999", "up=fast", "down=0GB/s", "rate=0",
                     "rate=-1G", "rate=nan", "rate=2.5Xtests/s", "rate=", "memory=0", "memory=-1", "memory=much",
                     "latency=0us", "latency=-1us", "latency=nan", "latency=1h", "slots=0", "slots=17", "slots=1.5",
                     "slots=-1", "rate=1G,rate=2G"):
            self.fails(2, "plan", path, "-r", "0.2", "--device", "sim", "--sim", spec, says="--sim")
        done = self.fails(2, "plan", path, "--device", "sim", "--sim", "pcie=-12", says=["--sim pcie", "-12", "GB/s"])
        self.assertNotIn("usage", done.err)

    def test_flags_about_a_device_need_one(self):
        path = self.scene()
        for args in (["--sim", "h200"], ["--device-memory", "1G"], ["--block-size", "16"], ["--boundary", "halo"]):
            self.fails(2, "plan", path, "--device", "cpu", *args, says=[args[0], "--device sim"])
        self.fails(2, "plan", path, "--sim", "h200", says=["--sim", "--device sim"])

    def test_cuda_is_refused_with_a_reason(self):
        path = self.scene()
        for device in ("cuda", "cuda:0"):
            self.fails(5, "plan", path, "--device", device, says=[device, "CUDA", "--device cpu"])

    def test_files_that_are_not_there(self):
        self.fails(3, "plan", self.path("missing.vdb"), "-r", "1", says="missing.vdb")
        self.fails(2, "plan")
        self.fails(4, "plan", self.scene("block", 20000), "--host-memory", "1K", says="--host-memory")

    def test_summary(self):
        path = self.scene("spray", 5000)
        done = self.succeeds("plan", path, "-r", "0.2", "--device", "sim:2", "--device-memory", "100K")
        self.assertEqual(done.err, "")
        for label in ("particles", "radius", "cells", "estimate", "tests", "needs", "tree", "blocks", "boundary",
                      "sim:0", "sim:1", "cpu", "output", "predicted", "time", "plan"):
            self.assertRegex(done.out, rf"(?m)^ *{label} ")
        self.assertEqual(self.succeeds("plan", path, "-r", "0.2", "-q"), (0, "", ""))
        rates = {re.search("for all [0-9]+ threads that there are, taken to make .* tests a second", done.err).group()
                 for done in (self.succeeds("plan", path, "-r", "0.2", "-v", "-T", threads) for threads in (1, 2))}
        self.assertEqual(len(rates), 1)
        self.assertIn("The plan itself is for all threads", " ".join(run("plan", "--help").out.split()))
        self.assertIn("suggests the radius", self.succeeds("plan", path).err)
        lines = self.succeeds("plan", path, "-r", "0.2", "--progress", "always").err.splitlines()
        self.assertEqual(lines[-1], "PROGRESS 100%")


class Picture(PlanCase):
    def draw(self, path, *args):
        target = self.path("plan.svg")
        self.succeeds("plan", path, "-q", "-f", "--svg", target, *args)
        self.assertLess(os.path.getsize(target), 2_000_000)
        return ElementTree.parse(target).getroot()

    def test_one_rectangle_a_block(self):
        path = self.scene("spray", 20000)
        args = ["--device", "sim:2", "--device-memory", "200K", "--boundary", "cpu"]
        root = self.draw(path, *args)
        name = "{http://www.w3.org/2000/svg}"
        self.assertEqual(root.tag, name + "svg")
        plan = self.plan(path, *args)["plan"]
        rectangles = root.find(name + "g").findall(name + "rect")
        self.assertEqual(len(rectangles), plan["blocks"])
        executors = {b["executor"] for b in plan["blocks_list"]}
        self.assertEqual(len({r.get("class").split()[0] for r in rectangles}), len(executors))
        self.assertTrue(any("b" in r.get("class").split() for r in rectangles))
        text = " ".join(t.text for t in root.iter(name + "text"))
        for word in ("spray.vdb", "radius", "sim:0", "sim:1", "cpu", "boundary", "world units", "tests"):
            self.assertIn(word, text)

    def test_every_kind_of_scene(self):
        for scene in ("sheet", "outlier", "lattice", "coincident"):
            self.draw(self.scene(scene, 2000), "--device", "sim", "--device-memory", "50K")
        self.draw(self.scene("block", 2000))

    def test_same_picture_for_any_number_of_threads(self):
        path = self.scene("spray", 20000)
        args = ["--device", "sim:2", "--device-memory", "200K", "--boundary", "cpu"]
        pictures = set()
        for threads in ("1", "2", "5"):
            self.draw(path, *args, "-T", threads)
            pictures.add(self.bytes(self.path("plan.svg")))
        self.assertEqual(len(pictures), 1)

    def test_awkward_names(self):
        path = self.scene("block", 500)
        for name in ("<a&b>\".vdb", "\x01.vdb"):
            os.rename(path, self.path(name))
            path = self.path(name)
            self.draw(path)
        raw = os.fsencode(self.path("")) + b"\xff.vdb"
        os.rename(path, raw)
        target = self.path("raw.svg")
        self.assertEqual(run("plan", os.fsdecode(raw), "-q", "--svg", target).code, 0)
        ElementTree.parse(target)

    def test_targets(self):
        path, target = self.scene(), self.text("x.svg", "precious")
        self.fails(2, "plan", path, "--svg", target, says=["x.svg", "force"])
        with open(target) as file:
            self.assertEqual(file.read(), "precious")
        self.succeeds("plan", path, "--svg", target, "-f", "-q")
        ElementTree.parse(target)
        self.fails(2, "plan", path, "--svg", path, "-f", says="input")
        self.fails(2, "plan", path, "--svg", self.path("y"), "--json", self.path("y"), says="two outputs")
        self.fails(2, "plan", path, "--json", path, "-f", says="input")
        self.fails(2, "plan", path, "--svg", "", says="--svg")
        self.fails(6, "plan", path, "--svg", self.path("no/such/x.svg"), says="x.svg")
        out = self.path("r.json")
        self.assertIn("written", self.succeeds("plan", path, "--svg", self.path("z.svg"), "--json", out).out)
        with open(out) as file:
            self.assertGreater(json.load(file)["seconds"]["write"], 0)
