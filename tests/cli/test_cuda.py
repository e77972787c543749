"""Search on CUDA devices: the files of the CPU, byte for byte, and what is said where devices are missing or small. Runs with
the program on emulated devices; VDB_NNS_EMULATED_DEVICES says how much memory each has, in MiB."""
import os

import cli_case
from cli_case import CliCase


def machine(*mebibytes, seed=1):
    return {**os.environ, "VDB_NNS_EMULATED_DEVICES": ",".join(map(str, mebibytes)), "VDB_NNS_EMULATED_SEED": str(seed)}


class CudaCase(CliCase):
    def search(self, path, out, *args, env=machine(1024)):
        return self.report("search", path, "-q", "-o", out, "-f", *args, env=env)

    def same(self, a, b):
        with open(a, "rb") as first, open(b, "rb") as second:
            self.assertTrue(first.read() == second.read(), f"{a} and {b} differ")


class SameBytes(CudaCase):
    def test_any_budget_boundary_encoding_and_block_size(self):
        for scene, count in (("block", 5000), ("spray", 5000), ("clusters", 2000), ("lattice", 2000)):
            path = self.scene(scene, count)
            plain, out = self.path("plain.npz"), self.path("cuda.npz")
            expected = self.search(path, plain, "--device", "cpu")
            need = self.report("plan", path, "-q", "--device", "cuda", "--encoding", "index", env=machine(1024))
            need = need["plan"]["estimated_bytes"]
            runs = [["--device-memory", str(need * 2)], ["--device-memory", str(need // 2), "--encoding", "mask"]]
            quarter = ["--device-memory", str(need // 4)]
            runs += [quarter + ["--boundary", "cpu"], quarter + ["--boundary", "halo"], quarter + ["--block-size", "16"]]
            for seed, args in enumerate(runs):
                with self.subTest(scene=scene, args=args):
                    report = self.search(path, out, "--device", "cuda", *args, env=machine(1024, seed=seed))
                    self.same(plain, out)
                    self.assertEqual(report["result"], expected["result"])
                    self.assertEqual(sum(d["particles"] for d in report["devices"]), count)
                    device = report["devices"][0]
                    self.assertEqual(device["kind"], "cuda")
                    self.assertLessEqual(device["peak_bytes"], device["budget_bytes"])
                    if device["blocks"] > 0:
                        for key in ("busy_seconds", "upload_seconds", "download_seconds", "bytes_up", "bytes_down"):
                            self.assertGreater(device[key], 0, key)

    def test_counts_into_a_vdb_file(self):
        path = self.scene("block", 4000)
        plain, out = self.path("plain.vdb"), self.path("cuda.vdb")
        expected = self.search(path, plain, "--device", "cpu", "--checksum", "--encoding", "none")
        report = self.search(path, out, "--device", "cuda", "--checksum", "--encoding", "none")
        self.assertEqual(report["result"], expected["result"])
        with open(plain, "rb") as first, open(out, "rb") as second:
            a, b = first.read(), second.read()
        self.assertTrue(a[:21] == b[:21] and a[57:] == b[57:], "more than the UUID differs")


class Devices(CudaCase):
    def test_all_or_one_of_several(self):
        path = self.scene("block", 6000)
        plain, out = self.path("plain.npz"), self.path("cuda.npz")
        self.search(path, plain, "--device", "cpu")
        two = machine(512, 256)
        small = ["--device-memory", "300K", "--boundary", "halo"]
        report = self.search(path, out, "--device", "cuda", *small, env=two)
        self.same(plain, out)
        self.assertEqual([d["kind"] for d in report["devices"]], ["cuda", "cuda", "cpu"])
        one = self.search(path, out, "--device", "cuda:1", env=two)
        self.same(plain, out)
        self.assertEqual([d["kind"] for d in one["devices"]], ["cuda", "cpu"])
        self.assertLess(one["devices"][0]["budget_bytes"], 256 << 20)
        self.fails(5, "search", path, "--device", "cuda:2", says=["cuda:2", "2 CUDA devices"], env=two)

    def test_auto_takes_what_is_there(self):
        path = self.scene("block", 2000)
        out = self.path("lists.npz")
        self.assertEqual(self.search(path, out)["devices"][0]["kind"], "cuda")
        self.assertEqual(self.search(path, out, env=machine())["devices"][0]["kind"], "cpu")

    def test_none_is_an_error_where_one_was_asked_for(self):
        path = self.scene("block", 1000)
        for device in ("cuda", "cuda:0"):
            self.fails(5, "search", path, "--device", device, says=["--device " + device, "--device cpu"], env=machine())
            self.fails(5, "plan", path, "--device", device, says=["--device " + device], env=machine())

    def test_a_full_device_is_left_out(self):
        path = self.scene("block", 2000)
        out = self.path("lists.npz")
        self.fails(5, "search", path, "--device", "cuda", says=["no memory free"], env=machine(64))
        self.assertEqual(self.search(path, out, env=machine(64))["devices"][0]["kind"], "cpu")
        done = self.succeeds("search", path, "-o", out, "-f", env=machine(64, 512))
        self.assertIn("left out: CUDA device 0", done.err)

    def test_memory_that_is_not_there_makes_smaller_blocks(self):
        path = self.scene("block", 20000)
        plain, out = self.path("plain.npz"), self.path("cuda.npz")
        self.search(path, plain, "--device", "cpu")
        # 64 MiB are the driver's, so one is left.
        report = self.search(path, out, "--device", "cuda", "--device-memory", "1GiB", env=machine(65))
        self.same(plain, out)
        self.assertGreater(report["estimate"]["halvings"], 0)
        self.assertLessEqual(report["devices"][0]["peak_bytes"], 1 << 20)
        self.assertGreater(report["devices"][0]["particles"], 0)

    def test_simulation_is_of_simulated_devices(self):
        path = self.scene("block", 1000)
        self.fails(2, "search", path, "--device", "cuda", "--sim", "h200", says=["--sim", "--device sim"], env=machine(1024))
