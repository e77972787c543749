#!/usr/bin/env python3
"""Instructions of a warp in the kernels' loops, counted in the machine code, as a table in Markdown.

usage: kernel_instructions.py NVCC NVDISASM ARCHITECTURE..   e.g. kernel_instructions.py nvcc nvdisasm 90
Exit 1 if a loop over queries touches local memory. nvdisasm comes with CUDA's toolkit, or with
`pip install nvidia-cuda-nvdisasm`.

A loop over queries is an innermost one of those with votes and fused products; the table has the one of a kernel that tests the most
words. "A cell" is the rest of the loop over cells around it, so far as it may lie on the way there; "-" where the code has that loop in
pieces. Counted is what runs every time: not the call that lists undecided pairs and what is spilled around it, nor what is for warps
that have diverged. Exit 77, with the reason, where a tool is missing.
"""
import importlib.util
import os
import re
import shutil
import subprocess
import sys
import tempfile

from kernel_resources import ROOT, SOURCE, passes

INSTRUCTION = re.compile(r"/\*[0-9a-f]{4,}\*/\s+(@!?U?P\w+\s+)?([A-Z][\w.]*)([^;]*);")
LABEL = re.compile(r"\s*(\.L_x_\d+):")
JUMPS = ("BRA", "BRX", "JMP")
RARE = "listUndecided"


def find(tool):
    """Its path: on PATH, where toolkits are, or in a package of this Python."""
    packages = importlib.util.find_spec("nvidia")
    places = packages.submodule_search_locations if packages else []
    folders = ["/usr/local/cuda/bin", "/opt/cuda/bin"] + [os.path.join(place, "cu13", "bin") for place in places]
    found = shutil.which(tool) or shutil.which(tool, path=os.pathsep.join(folders))
    if not found:
        print(f"SKIPPED: there is no '{tool}'")
        sys.exit(77)
    return found


def disassemble(nvcc, nvdisasm, architecture):
    with tempfile.TemporaryDirectory() as folder:
        code = os.path.join(folder, "kernels.cubin")
        compiler = [nvcc, "-std=c++17", "-O3", f"-arch=sm_{architecture}", "-cubin", "-Ikernels", "-Iinclude", "-o", code, SOURCE]
        for command in (compiler, [nvdisasm, "-c", code]):
            done = subprocess.run(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
            if done.returncode != 0:
                sys.exit(f"kernel_instructions: {' '.join(command)}:\n{done.stderr}")
    return done.stdout


class Block:
    """Instructions that run one after the other, by their names, and the blocks that may follow."""

    def __init__(self):
        self.names, self.after, self.is_rare = [], [], False


class Kernel:
    def __init__(self, listing):
        self.blocks = {}  # by label, or by number where it has none
        below = []        # pairs of blocks of which the second stands below the first, and may follow it
        block = last = None
        for line in listing.splitlines():
            label, found = LABEL.match(line), INSTRUCTION.search(line)
            if label or (found and block is None):
                name = label.group(1) if label else len(self.blocks)
                block = self.blocks[name] = Block()
                if last is not None:
                    below.append((last, name))
                last = name
            if not found:
                continue
            predicate, name, operands = found.groups()
            base, diverges = name.split(".")[0], name == "BRA.DIV"
            block.names.append(base)
            block.is_rare = base == "CALL" and RARE in operands
            if base in JUMPS and not diverges:
                block.after += re.findall(r"`\((\.L_x_\d+)\)", operands)
            if base in JUMPS + ("EXIT", "RET", "CALL"):
                # A condition may also stand first among the operands.
                if base != "CALL" and not diverges and not predicate and not re.match(r"\s+!?U?P\d", operands):
                    last = None
                block = None
        for first, second in below:
            self.blocks[first].after.append(second)
        self.entry = next(iter(self.blocks))
        self.loops = self.find_loops()

    def reachable(self, start, closed=()):
        seen, left = set(), [start]
        while left:
            name = left.pop()
            if name not in seen and name not in closed:
                seen.add(name)
                left += self.blocks[name].after
        return seen

    def find_loops(self):
        """The blocks of each natural loop, by its first one."""
        loops, alive = {}, self.reachable(self.entry)
        for last in alive:
            for head in self.blocks[last].after:
                # It is one if no way leads to its end but through its head.
                if last != head and last in self.reachable(self.entry, {head}):
                    continue
                body, left = {head}, [last]
                while left:
                    name = left.pop()
                    if name not in body:
                        body.add(name)
                        left += [n for n in alive if name in self.blocks[n].after]
                loops.setdefault(head, set()).update(body)
        return loops

    def round(self, head, through=None, without=frozenset()):
        """The blocks of a loop on a way around without a rare call: from its head to a block of it, and to its head again."""
        through = through or head
        closed = {n for n in self.blocks if n not in self.loops[head] or self.blocks[n].is_rare} | without
        ends = {n for n in self.reachable(through, closed) if head in self.blocks[n].after}
        back = {n for n in self.reachable(through, closed) if ends & self.reachable(n, closed)}
        there = set()
        if through != head:
            there = {n for n in self.reachable(head, closed | {through}) if through in self.reachable(n, closed | {head} - {n})}
        return there | back

    def names(self, blocks):
        return [name for n in blocks for name in self.blocks[n].names]

    def query_loops(self):
        """The names of the instructions of each, by its first block."""
        found = {head: self.names(self.round(head)) for head in self.loops}
        tests = {head for head, names in found.items() if names.count("VOTE") > 1 and products(names) > 1}
        return {head: found[head] for head in tests if not tests & self.loops[head] - {head}}


def products(names):
    return sum(name.startswith("FFMA") for name in names)


def local_memory(names):
    return sum(name in ("LDL", "STL") for name in names)


def row(kernel):
    """Instructions in the loop over queries; in the loop over cells beside it; whether any loop over queries spills."""
    loops = kernel.query_loops()
    if not loops:
        outer = max(kernel.loops, key=lambda head: len(kernel.names(kernel.loops[head])))
        return "-", len(kernel.names(kernel.round(outer))), "-"
    widest = max(loops, key=lambda head: products(loops[head]))
    around = [head for head, body in kernel.loops.items() if head != widest and widest in body]
    worst = max(local_memory(names) for names in loops.values())
    if len(around) < 2:  # over what is gathered at a time, and over cells
        return len(loops[widest]), "-", worst
    outer = max(around, key=lambda head: len(kernel.loops[head]))
    others = frozenset().union(*(kernel.loops[h] for h in loops if h != widest)) - kernel.loops[widest]
    cell = kernel.names(kernel.round(outer, widest, others) - kernel.loops[widest])
    return len(loops[widest]), len(cell), worst


def main():
    if len(sys.argv) < 4:
        sys.exit(__doc__)
    nvcc, nvdisasm = find(sys.argv[1]), find(sys.argv[2])
    names, spilled = passes(), []
    print("| architecture | kernel | a query | a cell | of a query: local memory |\n|---|---|---|---|---|")
    for architecture in sys.argv[3:]:
        listings = re.split(r"\n\s*\.section\s+\.text\.", disassemble(nvcc, nvdisasm, architecture))
        kernels = {}
        for listing in listings:
            number = re.match(r"\w*?searchGroupsKernelI\w*?PassE(\d+)E", listing)
            if number:
                kernels[names[int(number.group(1))]] = Kernel(listing)
        if len(kernels) != len(names):
            sys.exit(f"kernel_instructions: of {names} there is only {sorted(kernels)} in the code for sm_{architecture}")
        for name, kernel in sorted(kernels.items()):
            cells = row(kernel)
            print(f"| sm_{architecture} | `searchGroupsKernel<{name}>` | " + " | ".join(map(str, cells)) + " |")
            if name != "kMeasure" and cells[2] != 0:  # which tests nothing
                spilled.append(f"{name} for sm_{architecture}")
    if spilled:
        sys.exit("loops over queries that touch local memory, or are not found: " + ", ".join(spilled))


if __name__ == "__main__":
    main()
