"""The scripts for machines with a GPU, where there is none: tools/gpu_bench.sh in small on emulated devices runs to its end, prints
every row and writes its reports; tools/gpu_check.sh judges stand-ins for the tests and for compute-sanitizer; tools/gpu_session.sh is
rehearsed with both and a stand-in for ncu.

usage: test_gpu_scripts.py TOOLS_FOLDER VDB_NNS_EMULATED VDB_NNS_EMULATED_FORMER TEST_CUDA_EMULATED
"""
import datetime
import json
import os
import shutil
import subprocess
import sys
import tarfile
import tempfile
import time
import unittest

KEYS = ["agreement", "kernel_mask", "kernel_index", "kernel_floor", "cut_mask", "cut_index", "per_gib_index", "per_gib_mask", "link_share",
        "end_to_end", "over_mapped", "mapped_link", "over_all_cores", "block_sizes", "cpu_and_gpu", "index_link_share",
        "over_one_core", "scale", "former_mask", "former_index"]


def gpu_bench(*args, **variables):
    return run("gpu_bench.sh", args, emulated(**variables))


def emulated(**variables):
    return {**os.environ, "VDB_NNS": PROGRAM, "VDB_NNS_FORMER": FORMER, "TEST_CUDA_GPU": TESTS, "VDB_NNS_EMULATED_DEVICES": "256",
            **variables}


def run(script, args, environment):
    return subprocess.run([os.path.join(TOOLS, script), *args], stdout=subprocess.PIPE, stderr=subprocess.PIPE, stdin=subprocess.DEVNULL,
                          env=environment, universal_newlines=True, timeout=300)


class ScriptCase(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory(prefix="vdb_nns_gpu_bench_")
        self.addCleanup(folder.cleanup)
        self.folder = folder.name

    def program(self, name, lines):
        path = os.path.join(self.folder, name)
        with open(path, "w") as file:
            file.write("#!/bin/sh\n" + lines)
        os.chmod(path, 0o755)
        return path


class GpuBench(ScriptCase):
    def test_all_rows(self):
        out = os.path.join(self.folder, "with a space")
        done = gpu_bench("--tiny", out)
        self.assertEqual(done.returncode, 0, done.stdout + done.stderr)
        with open(os.path.join(out, "summary.json")) as file:
            summary = json.load(file)
        self.assertEqual((summary["schema"], summary["tiny"], summary["agree"], summary["failed_steps"]),
                         (1, True, True, []))
        self.assertEqual([row["key"] for row in summary["rows"]], KEYS)
        lines = done.stdout.splitlines()
        for row in summary["rows"]:
            self.assertIn(row["reached"], ("yes", "no", "-"), row)
            self.assertNotIn("failed", row["value"], row)
            self.assertIsInstance(row["number"], (int, float), row)
            cells = [row[key] for key in ("what", "value", "bar", "reached", "note")]
            self.assertEqual(len([line for line in lines if [c.strip() for c in line.split("|")[1:-1]] == cells]), 1, row)
        by_key = {row["key"]: row for row in summary["rows"]}
        self.assertEqual(by_key["agreement"]["reached"], "yes")
        for key in set(KEYS) - {"agreement", "per_gib_index", "per_gib_mask"}:
            self.assertIn("n=1", by_key[key]["note"])
        self.assertIn("a guess", by_key["kernel_floor"]["note"])
        self.assertNotIn("tests", by_key["kernel_floor"]["value"])
        self.assertNotRegex(by_key["scale"]["note"], r"in [01] blocks")
        self.check_summary(out, summary)
        reports = {}
        for name in os.listdir(out):
            if name.endswith(".json"):
                with open(os.path.join(out, name)) as file:
                    reports[name] = json.load(file)
        for key in ("up_gbs", "down_gbs", "both_up_gbs", "both_down_gbs"):
            self.assertGreater(reports["large.json"]["link"][key], 0)
        mapped = [r["device"] for r in reports["large.json"]["results"] if r["method"] == "mapped-mask"][0]
        self.assertGreater(mapped["kernel_gbs"], 0)
        self.assertGreater(mapped["bytes_up"], 0)
        self.assertEqual((mapped["upload_seconds"], mapped["in_core"], mapped["virtual"]), (0, True, False))
        for name, report in reports.items():
            for result in report.get("results", []):
                self.assertEqual((result["device"] or {"halvings": 0})["halvings"], 0, name)

    def check_summary(self, out, summary):
        self.assertEqual(summary["device"], "SIMT emulation")
        date = datetime.datetime.strptime(summary["date"], "%Y-%m-%dT%H:%M:%SZ")
        self.assertLess(abs((datetime.datetime.now(datetime.timezone.utc).replace(tzinfo=None) - date).total_seconds()), 600)
        self.assertGreater(summary["machine"]["cores"], 0)
        self.assertGreater(summary["machine"]["memory_bytes"], 1 << 20)
        with open(os.path.join(out, "simt-emulation-" + summary["date"][:10] + ".json")) as file:
            self.assertEqual(json.load(file), summary)

    def stand_in(self, lines):
        return self.program("stand in", lines)

    def agreement(self, lines):
        done = gpu_bench("--tiny", self.folder, VDB_NNS=self.stand_in(lines + "\nexit 0\n"))
        with open(os.path.join(self.folder, "summary.json")) as file:
            summary = json.load(file)
        row = summary["rows"][0]
        self.assertEqual((row["key"], row["reached"]), ("agreement", "no"))
        return done, summary, row

    def test_not_measured_is_no_disagreement(self):
        done, summary, row = self.agreement('case "$*" in *sheet*) exit 4 ;; *far*) exit 5 ;; *seam*) exit 124 ;; esac')
        self.assertEqual((done.returncode, summary["agree"], row["value"]), (0, None, "8 of 11 scenes"), done.stderr)
        self.assertIn("not measured: sheet far seam;", row["note"])
        self.assertNotIn("differ", row["note"])
        self.assertEqual(summary["failed_steps"], ["agree_sheet", "agree_far", "agree_seam"])

    def test_disagreement(self):
        done, summary, row = self.agreement('case "$*" in *sheet*) exit 1 ;; *far*) exit 4 ;; esac')
        self.assertEqual((done.returncode, summary["agree"], row["value"]), (1, False, "9 of 11 scenes"), done.stderr)
        self.assertIn("differ: sheet; not measured: far;", row["note"])
        self.assertIn("methods disagree: agree_sheet\n", done.stdout)

    def test_a_program_that_does_not_run(self):
        for code in (126, 127):
            done = gpu_bench(self.folder, VDB_NNS=self.stand_in(f"echo no library >&2\nexit {code}\n"))
            self.assertEqual(done.returncode, 2)
            self.assertIn("does not run: no library", done.stderr)

    def test_a_checkout_has_a_folder_where_the_program_would_be(self):
        shutil.copy(os.path.join(TOOLS, "gpu_bench.sh"), self.folder)
        os.mkdir(os.path.join(self.folder, "vdb_nns"))
        environment = {key: value for key, value in os.environ.items() if key != "VDB_NNS"}
        done = run(os.path.join(self.folder, "gpu_bench.sh"), [self.folder + "/results"], environment)
        self.assertEqual(done.returncode, 2)
        self.assertIn("VDB_NNS=build/vdb_nns tools/gpu_bench.sh results", done.stderr)
        self.assertFalse(os.path.exists(self.folder + "/results"))

    def test_methods_that_take_each_others_memory(self):
        command = [PROGRAM, "bench", "--scene", "block", "-n", "14k", "--device", "cuda", "--device-memory", "1MB",
                   "--repeat", "1", "--sample", "0", "--method"]
        environment = {**os.environ, "VDB_NNS_EMULATED_DEVICES": "66"}
        few, many = "in-core-mask,blocks-mask", "in-core-mask,blocks-mask,both-halo-mask,both-auto-mask"
        for methods, code in ((few, 0), (many, 4)):
            done = subprocess.run(command + [methods], stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=environment,
                                  universal_newlines=True, timeout=300)
            self.assertEqual(done.returncode, code, done.stderr)
        # Which of them is the one too many follows from the order of the run.
        self.assertRegex(done.stderr, r"error: scene block: (%s): " % many.replace(",", "|"))
        for said in ("1000000 bytes", "other methods of this bench", "smaller --device-memory"):
            self.assertIn(said, done.stderr)

    def test_failures_are_told(self):
        done = gpu_bench("--tiny", self.folder, VDB_NNS_EMULATED_DEVICES="")
        self.assertEqual(done.returncode, 5, done.stderr)
        self.assertIn("CUDA", done.stderr)
        self.assertEqual(gpu_bench("--huge").returncode, 2)
        self.assertEqual(gpu_bench("--only", "all", self.folder).returncode, 2)
        self.assertEqual(gpu_bench("a", "b").returncode, 2)
        self.assertEqual(gpu_bench(self.folder, VDB_NNS=self.folder + "/none").returncode, 2)


# What Nsight Compute writes: a head, units, and a line for each kernel.
NCU = """
while [ "$1" != --log-file ]; do shift; done
printf '%s\n' '==PROF== Connected to process 1' '"ID","Kernel Name","smsp__inst_executed.sum","unit__other.sum"' '"","","inst",""' \
    '"0","void searchGroupsKernel<2>(A, B)","1,234","5"' >"$2"
shift 2
exec "$@"
"""


class GpuSession(ScriptCase):
    """The rehearsal: limits of what comes back, every step there, in an environment without a real GPU."""

    def session(self, call, *flags, **variables):
        tools = os.path.join(self.folder, "tools")
        os.makedirs(tools, exist_ok=True)
        self.program("tools/ncu", NCU)
        self.program("tools/nvidia-smi", "echo name, 1.2.3\n")
        self.program("tools/compute-sanitizer", SANITIZER.format(racecheck="1 hazard", memcheck="0 errors"))
        few = "*MappedMemory*"
        environment = emulated(PATH=tools + ":" + os.environ["PATH"], GTEST_FILTER=few, SELECTION=few)
        self.out = os.path.join(self.folder, "out")
        return run("gpu_session.sh", ["--tiny", *flags, call, self.out], {**environment, **variables})

    def kept(self, call):
        self.assertEqual(sorted(os.listdir(self.out)), [f"call{call}.tar.gz", f"call{call}.txt"])
        archive = os.path.join(self.out, f"call{call}.tar.gz")
        self.assertLess(os.path.getsize(archive), 16 << 20)
        with tarfile.open(archive) as tar:
            return {name[2:] for name in tar.getnames()}

    def test_call_1(self):
        done = self.session("1", "--host-memory", "4GiB")
        # The one step that fails is said to have, and stops nothing.
        self.assertEqual(done.returncode, 1, done.stdout + done.stderr)
        self.assertEqual([line.split()[3] for line in done.stdout.splitlines() if "FAILED with" in line and line.startswith("[")],
                         ["racecheck:"], done.stdout)
        for said in ("name, 1.2.3", "MemTotal", "tests      ok; 2 tests", "memcheck   ok;", "synccheck  ok;",
                     "| former kernels over those of now, block 1k, mask ", "| kernel, in core, block 1k, index ",
                     "| the same at once over in blocks, mask ", "void searchGroupsKernel<2>(A, B): smsp__inst_executed.sum 1,234"):
            self.assertEqual(done.stdout.count(said) > 0, True, said + " is not in\n" + done.stdout)
        self.assertNotIn("unit__other", done.stdout)
        self.assertNotIn("SKIPPED, no time", done.stdout)
        names = self.kept(1)
        self.assertTrue({"tests.txt", "racecheck.txt", "now.json", "former.json", "kernel.json", "ncu_mask.csv"} <= names, names)
        with open(os.path.join(self.out, "call1.txt")) as file:
            self.assertEqual(file.read(), done.stdout)

    def test_call_2(self):
        done = self.session("2")
        self.assertEqual(done.returncode, 0, done.stdout + done.stderr)
        self.assertNotIn("FAILED", done.stdout)
        for said in ("CPU = GPU = CPU + GPU, checksums", "masks: upload + search + download", "over mapped host memory", "time by size of",
                     "makespan over lower bound", "1x, 4x, 16x larger", "with host bucketing"):
            self.assertEqual(done.stdout.count(said), 1, said)
        self.assertTrue({"agree_seam.json", "large.json", "sizes.csv", "summary_scale.json"} <= self.kept(2))

    def test_what_is_missing_is_said(self):
        done = self.session("1", VDB_NNS_FORMER=self.folder + "/none", TEST_CUDA_GPU=self.folder + "/none", VDB_NNS_EMULATED_DEVICES="")
        self.assertEqual(done.returncode, 1)
        for step in ("tests", "memcheck", "racecheck", "synccheck"):
            self.assertIn(f"] {step}: SKIPPED, there is no program", done.stdout)
        self.assertIn("] kernel: FAILED with 5: ", done.stdout)
        self.assertIn("CUDA", done.stdout)

    def test_time_that_is_up(self):
        done = self.session("2", DEADLINE="0")
        self.assertEqual((done.returncode, done.stdout.count("SKIPPED, no time is left")), (1, 5), done.stdout)
        self.kept(2)

    def test_a_step_that_hangs_loses_what_follows(self):
        started = time.monotonic()
        done = self.session("1", TEST_CUDA_GPU=self.program("hangs", "sleep 100\n"), DEADLINE="6")
        self.assertLess(time.monotonic() - started, 60)
        self.assertEqual(done.returncode, 1)
        self.assertRegex(done.stdout, "tests +FAILED: no end within [1-6] s")
        self.assertGreater(done.stdout.count("SKIPPED, no time is left"), 4, done.stdout)
        self.assertIn("tests.txt", self.kept(1))

    def test_bad_arguments(self):
        for arguments in ([], ["3"], ["1", "a", "b"], ["--huge", "1"], ["1", ""]):
            self.assertEqual(run("gpu_session.sh", arguments, os.environ).returncode, 2, arguments)
        done = run("gpu_session.sh", ["--help"], os.environ)
        self.assertEqual((done.returncode, done.stderr), (0, ""))
        self.assertIn("DEADLINE=SECONDS", done.stdout)


SANITIZER = """
case "$*" in *--version*) echo "Version 1"; exit ;; *racecheck*) echo "===== RACECHECK SUMMARY: {racecheck} displayed" ;;
*memcheck*) echo "===== ERROR SUMMARY: {memcheck}" ;; *) echo "===== ERROR SUMMARY: 0 errors" ;; esac
while [ "${{1#--}}" != "$1" ]; do shift 2; done
"$@"
"""


class GpuCheck(ScriptCase):
    def check(self, tests="echo '[  PASSED  ] 2 tests.'", racecheck="0 hazards", memcheck="0 errors", **variables):
        self.program("compute-sanitizer", SANITIZER.format(racecheck=racecheck, memcheck=memcheck))
        environment = {**os.environ, "PATH": self.folder + ":" + os.environ["PATH"], **variables}
        return run("gpu_check.sh", [self.program("tests", tests), self.folder + "/logs"], environment)

    def test_verdicts(self):
        done = self.check()
        self.assertEqual(done.returncode, 0, done.stdout + done.stderr)
        self.assertEqual([line.split()[:2] for line in done.stdout.splitlines()],
                         [[name, "ok;"] for name in ("tests", "memcheck", "racecheck", "initcheck", "synccheck")])
        for name, failing in (("memcheck", {"memcheck": "3 errors"}), ("racecheck", {"racecheck": "1 hazard"})):
            done = self.check(**failing)
            self.assertEqual(done.returncode, 1)
            self.assertEqual([line.split()[0] for line in done.stdout.splitlines() if "FAILED" in line], [name])
        for tests in ("exit 1", "echo '[  PASSED  ] 0 tests.'", "echo nothing",
                      "echo '[  SKIPPED ] a'; echo '[  PASSED  ] 1 test.'"):
            done = self.check(tests)
            self.assertEqual((done.returncode, done.stdout.count("FAILED")), (1, 5), done.stdout)

    def test_bad_arguments(self):
        self.assertEqual(run("gpu_check.sh", [], os.environ).returncode, 2)
        self.assertEqual(run("gpu_check.sh", [self.folder], os.environ).returncode, 2)
        for flag in ("-h", "--help"):
            done = run("gpu_check.sh", [flag], os.environ)
            self.assertEqual((done.returncode, done.stderr), (0, ""))
            self.assertIn("TEST_CUDA_GPU", done.stdout)
        self.assertEqual(run("gpu_check.sh", [self.folder + "/none"], os.environ).returncode, 2)


if __name__ == "__main__":
    TOOLS, PROGRAM, FORMER, TESTS = sys.argv[1:5]
    unittest.main(argv=sys.argv[:1] + sys.argv[5:], verbosity=2)
