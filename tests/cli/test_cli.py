"""Tests of the command line: exit codes, stdout, stderr, files. No test here knows how the engine works.

usage: test_cli.py VDB_NNS MAKE_FIXTURES [unittest's arguments, e.g. test_inputs]
"""
import sys
import unittest

import cli_case

MODULES = ["test_usage", "test_inputs", "test_formats", "test_outputs", "test_streams", "test_memory", "test_lists", "test_interrupt",
           "test_verify", "test_verify_attributes", "test_queries", "test_measures", "test_measure_bytes", "test_attributes", "test_bench",
           "test_plan", "test_device", "test_convert", "test_frames", "test_tiles"]  # test_cuda needs the program on emulated devices

if __name__ == "__main__":
    if len(sys.argv) < 3:
        sys.exit(__doc__)
    cli_case.BINARY, cli_case.MAKE_FIXTURES = sys.argv[1:3]
    unittest.main(module=None, argv=[sys.argv[0], *(sys.argv[3:] or MODULES)], verbosity=2)
