"""Runs what README.md shows: its `build/vdb_nns` commands on a smaller scene, then its Python blocks on what they wrote.

    check_readme_code.py SOURCE_DIR VDB_NNS [VDB_NNS_EMULATED]

The commands that demand a GPU run with the program on an emulated one, where there is that.
"""

import os
import re
import subprocess
import sys
import tempfile

source, program, *emulated = map(os.path.abspath, sys.argv[1:])
with open(os.path.join(source, "README.md"), encoding="utf-8") as file:
    blocks = re.findall(r"^```(\w+)\n(.*?)^```", file.read(), re.M | re.S)
commands = [line for kind, text in blocks if kind == "sh" for line in text.splitlines() if line.startswith("build/vdb_nns")]
snippets = [text for kind, text in blocks if kind == "python"]
assert len(commands) >= 4 and len(snippets) == 2, (commands, snippets)

with tempfile.TemporaryDirectory() as folder:
    os.chdir(folder)
    for command in commands:
        needs_gpu = "--device cuda" in command
        if needs_gpu and not emulated:
            print("not run:", command)
            continue
        command = command.replace("--stability", "--stability --method ours-count")  # all methods take minutes
        command = command.replace("build/vdb_nns", f"'{emulated[0] if needs_gpu else program}'", 1).replace("1000000", "20000")
        subprocess.run(command, shell=True, check=True, stdout=subprocess.DEVNULL)
    names = {}
    for snippet in snippets:
        exec(snippet, names)
    lists = names["lists"]
    assert (lists.indptr == names["indptr"]).all() and (lists.indices == names["indices"]).all()
    assert len(names["neighbors_of_7"]) == lists.indptr[8] - lists.indptr[7]
    assert lists.nnz > 20000, "a scene of 20000 particles has more pairs than particles"
print(f"{len(commands)} commands and {len(snippets)} Python blocks of README.md work")
