#!/usr/bin/env python3
"""What the kernels take of a multiprocessor, as a table in Markdown.

usage: kernel_resources.py NVCC ARCHITECTURE..   e.g. kernel_resources.py nvcc 75 90
The target `kernel_resources` runs it for the architectures of the build.
"""
import os
import re
import subprocess
import sys
import tempfile

ROOT = os.path.join(os.path.dirname(os.path.abspath(__file__)), "..", "..")
SOURCE = "kernels/cuda/search_block.cu"


def passes():
    """The enumerators of `Pass`, which template arguments are printed by the number of."""
    with open(os.path.join(ROOT, SOURCE), encoding="utf-8") as file:
        body = re.search(r"enum class Pass \{(.*?)\}", file.read(), re.S).group(1)
    return re.findall(r"\b(k[A-Z]\w*)", re.sub(r"//.*", "", body))


def compile_report(nvcc, architecture):
    with tempfile.TemporaryDirectory() as folder:
        command = [nvcc, "-std=c++17", "-O3", f"-arch=sm_{architecture}", "-cubin", "-Xptxas", "-v", "-Ikernels",
                   "-Iinclude", "-o", os.path.join(folder, "kernels.cubin"), SOURCE]
        done = subprocess.run(command, cwd=ROOT, stderr=subprocess.PIPE, text=True)
    if done.returncode != 0:
        sys.exit(f"kernel_resources: nvcc cannot compile for sm_{architecture}:\n{done.stderr}")
    return subprocess.run(["c++filt"], input=done.stderr, stdout=subprocess.PIPE, text=True, check=True).stdout


def rows(report, names):
    for entry in re.split(r"Compiling entry function", report)[1:]:
        kernel, number = re.search(r"::(\w+Kernel)(?:<[^>]*Pass\)(\d+)>)?", entry).groups()
        registers = re.search(r"Used (\d+) registers", entry).group(1)
        shared = re.search(r"(\d+) bytes smem", entry)
        spills = re.search(r"(\d+) bytes spill stores, (\d+) bytes spill loads", entry).groups()
        label = f"`{kernel}<{names[int(number)]}>`" if number else f"`{kernel}`"
        yield label, registers, " / ".join(spills), shared.group(1) if shared else "0"


def main():
    if len(sys.argv) < 3:
        sys.exit(__doc__)
    names = passes()
    print("| architecture | kernel | registers | bytes spilled: stored / loaded | bytes shared |\n|---|---|---|---|---|")
    for architecture in sys.argv[2:]:
        for row in sorted(rows(compile_report(sys.argv[1], architecture), names)):
            print(f"| sm_{architecture} | " + " | ".join(row) + " |")


if __name__ == "__main__":
    main()
