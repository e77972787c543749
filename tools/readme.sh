#!/usr/bin/env bash
# Writes again what the documents quote: the example of README.md, which is samples/readme_example.cpp, and the flag tables of
# docs/cli.md, which the program prints: tools/readme.sh [build/vdb_nns]
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
program=${1:-build/vdb_nns}
/usr/bin/python3 - "$program" <<'PYTHON'
import subprocess, sys

def put(path, begin, end, body):
    with open(path, encoding="utf-8") as file:
        text = file.read()
    head, rest = text.split(begin, 1)
    with open(path, "w", encoding="utf-8") as file:
        file.write(head + begin + "\n" + body.strip() + "\n" + end + rest.split(end, 1)[1])

table = subprocess.run([sys.argv[1], "--help-markdown"], check=True, capture_output=True, text=True).stdout
put("docs/cli.md", "<!-- vdb_nns --help-markdown -->", "<!-- end of --help-markdown -->", table)
with open("samples/readme_example.cpp", encoding="utf-8") as file:
    sample = file.read()
put("README.md", "<!-- samples/readme_example.cpp -->\n```cpp", "```\n<!-- end of the example -->", sample)
PYTHON
echo "README.md and docs/cli.md are up to date"
