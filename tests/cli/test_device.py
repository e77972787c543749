"""Search on simulated devices: the files of the plain search, byte for byte, and a report that adds up."""
import json
import os
import signal
import subprocess
import time

import cli_case
from cli_case import CliCase


def without_measures(report):
    """What two runs have in common."""
    report = json.loads(json.dumps(report))
    del report["seconds"], report["memory"]["peak_rss_bytes"]
    for device in report["devices"]:
        if device["kind"] == "cpu":
            del device["budget_bytes"]
    return report


class DeviceCase(CliCase):
    def search(self, path, out, *args):
        report = self.report("search", path, "-q", "-o", out, "-f", *args)
        if report["devices"][0]["kind"] == "sim":
            self.check(report)
        return report

    def check(self, report):
        """What holds for every search on devices."""
        points = report["input"]["points"] - report["input"]["nonfinite"]
        self.assertEqual(report["devices"][-1]["kind"], "cpu")
        self.assertEqual(sum(d["particles"] for d in report["devices"]), points)
        for device in report["devices"][:-1]:
            self.assertLessEqual(device["peak_bytes"], device["budget_bytes"])
            self.assertLessEqual(device["busy_seconds"], report["plan"]["model_seconds"] * (1 + 1e-9))
        self.assertEqual(report["device"]["kind"], "sim")
        self.assertEqual(report["memory"]["device_peak_bytes"],
                         max(d["peak_bytes"] for d in report["devices"][:-1]))
        self.assertEqual(report["estimate"]["actual_pairs"], report["result"]["pairs"])
        for key in ("relative_error", "block_error_p50", "block_error_p99", "overflows", "retries", "splits", "halvings"):
            self.assertIsNotNone(report["estimate"][key], key)
        self.assertGreater(report["plan"]["lower_bound_seconds"], 0)
        self.assertGreaterEqual(report["plan"]["model_seconds"], report["plan"]["lower_bound_seconds"] * (1 - 1e-9))
        for step in ("estimate", "plan", "search"):
            self.assertGreater(report["seconds"][step], 0)
        self.assertNotIn("blocks_list", report["plan"])


class SameBytes(DeviceCase):
    def test_any_device_budget_boundary_estimator_and_block_size(self):
        for scene, count in (("block", 20000), ("spray", 20000), ("clusters", 6000)):
            path = self.scene(scene, count)
            plain, out = self.path("plain.npz"), self.path("sim.npz")
            expected = self.search(path, plain)
            need = self.report("plan", path, "-q", "--device", "sim", "--encoding", "index")["plan"]["estimated_bytes"]
            runs = [["--device-memory", str(int(need * share))] for share in (2, 0.5, 0.1, 0.01, 0.001)]
            tenth = ["--device-memory", str(need // 10)]
            runs += [tenth + ["--boundary", "cpu"], tenth + ["--boundary", "halo"]]
            runs += [tenth + ["--estimator", name]
                     for name in ("expected", "montecarlo", "sampled", "counted", "fixed")]
            runs += [tenth + ["--block-size", size] for size in ("8", "16", "32", "64")]
            runs += [tenth + ["--encoding", "mask"], tenth + ["--encoding", "mask", "--boundary", "cpu"]]
            runs += [tenth + ["--sim", "gtx780,memory=1GiB,slots=2"], tenth + ["-T", "1"], tenth + ["--repeat", "2"]]
            for number, flags in enumerate(runs):
                device = "sim:2" if number % 3 == 2 else "sim"
                report = self.search(path, out, "--device", device, *flags)
                with open(plain, "rb") as a, open(out, "rb") as b:
                    self.assertEqual(a.read(), b.read(), (scene, device, flags))
                self.assertEqual(report["result"], expected["result"])
                self.assertEqual(len(report["devices"]), 3 if device == "sim:2" else 2)

    def test_distances_and_counts(self):
        path = self.scene("spray", 5000)
        for extra in (["--lists", "distance"], []):
            plain, out = self.path("plain.npz"), self.path("sim.npz")
            self.search(path, plain, *extra)
            self.search(path, out, "--device", "sim", "--device-memory", "300KB", *extra)
            with open(plain, "rb") as a, open(out, "rb") as b:
                self.assertEqual(a.read(), b.read())
        plain = self.report("search", path, "-q", "--checksum")
        sim = self.report("search", path, "-q", "--checksum", "--device", "sim", "--device-memory", "100KB",
                          "--encoding", "none")
        self.assertEqual(sim["result"], plain["result"])
        self.assertEqual(sim["plan"]["encoding"], "none")

    def test_runs_report_the_same(self):
        path = self.scene("clusters", 6000)
        out = self.path("sim.npz")
        flags = ["--device", "sim:2", "--device-memory", "1MB"]
        first = self.search(path, out, *flags)
        for _ in range(3):
            self.assertEqual(without_measures(self.search(path, out, *flags)), without_measures(first))


class Report(DeviceCase):
    def test_in_core_and_out_of_core(self):
        path = self.scene("block", 20000)
        out = self.path("a.npz")
        report = self.search(path, out, "--device", "sim")
        self.assertTrue(report["plan"]["in_core"])
        self.assertEqual([d["blocks"] for d in report["devices"]], [1, 0])
        report = self.search(path, out, "--device", "sim", "--device-memory", "1MiB")
        self.assertFalse(report["plan"]["in_core"])
        self.assertGreater(report["devices"][0]["blocks"], 1)
        self.assertEqual(report["device"]["budget_bytes"], 1 << 20)

    def test_a_device_too_small_leaves_all_to_the_cpu_and_says_so(self):
        path = self.scene("block", 5000)
        report = self.search(path, self.path("a.npz"), "--device", "sim", "--device-memory", "100")
        self.assertEqual(report["estimate"]["too_large_queries"], 5000)
        self.assertEqual(report["devices"][0]["particles"], 0)
        text = self.succeeds("search", path, "--device", "sim", "--device-memory", "100").out
        self.assertIn("5000 particles fit no device", text)

    def test_the_summary_names_devices_and_errors(self):
        path = self.scene("block", 20000)
        text = self.succeeds("search", path, "--device", "sim:2", "--device-memory", "1MiB", "--encoding", "index").out
        for word in ("sim:0", "sim:1", "estimate", "blocks", "model", "lower bound"):
            self.assertIn(word, text)

    def test_an_estimate_far_too_small_is_redone(self):
        # The fixed estimate reserves 64 neighbors a particle, and 3000 particles at one point have 2999.
        path = self.scene("coincident", 3000)
        plain, out = self.path("plain.npz"), self.path("sim.npz")
        self.search(path, plain)
        report = self.search(path, out, "--device", "sim", "--device-memory", "2MB", "--estimator", "fixed",
                             "--encoding", "index")
        with open(plain, "rb") as a, open(out, "rb") as b:
            self.assertEqual(a.read(), b.read())
        self.assertGreater(report["estimate"]["overflows"], 0)
        self.assertGreater(report["estimate"]["retries"], 0)


class Mistakes(DeviceCase):
    def test_flags(self):
        path = self.scene("block", 100)
        for flags, says in ((["--device-memory", "0"], ["--device-memory"]),
                            (["--device-memory", "-5"], ["--device-memory"]),
                            (["--device-memory", "3 apples"], ["--device-memory", "3 apples"]),
                            (["--block-size", "12"], ["--block-size"]),
                            (["--estimator", "guess"], ["--estimator"]),
                            (["--boundary", "gpu"], ["--boundary"]),
                            (["--sim", "speed=1"], ["--sim", "speed"])):
            self.fails(2, "search", path, "--device", "sim", *flags, says=says)
        self.fails(2, "search", path, "--device", "cpu", "--device-memory", "1MB", says=["--device-memory"])
        self.fails(2, "search", path, "--device", "sim:0", says=["sim:N"])

    def test_interrupt_between_blocks(self):
        path = self.scene("block", 300000)
        out = self.path("a.npz")
        process = subprocess.Popen([cli_case.BINARY, "search", path, "-o", out, "--device", "sim", "--device-memory",
                                    "1MiB", "--progress", "always", "--repeat", "50"], stdout=subprocess.PIPE,
                                   stderr=subprocess.PIPE)
        time.sleep(1)
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=60)
        self.assertEqual(process.returncode, 130)
        self.assertEqual([name for name in os.listdir(self.folder) if "npz" in name], [])
