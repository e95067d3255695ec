#!/bin/sh
# Builds the Embree program that `nearfield-bench rays --embree PROGRAM` compares hits and times with:
#
#   crates/nearfield-bench/scripts/build_embree_peer.sh [PROGRAM]
#
# PROGRAM is target/embree_peer by default. Needs a C++ compiler and Embree 3 (Debian: libembree-dev); without them it says
# so and ends with 0, as the comparison is one that may be left out. CXXFLAGS and LDFLAGS are taken over.
set -eu
here=$(cd "$(dirname "$0")" && pwd)
program=${1:-target/embree_peer}
compiler=${CXX:-c++}
if ! command -v "$compiler" > /dev/null; then
    echo "skipped: no C++ compiler ($compiler); Embree is left out"
    exit 0
fi
if ! printf '#include <embree3/rtcore.h>\n' | "$compiler" ${CXXFLAGS:-} -x c++ -fsyntax-only - 2> /dev/null; then
    echo "skipped: no embree3/rtcore.h (Debian: apt-get install libembree-dev); Embree is left out"
    exit 0
fi
mkdir -p "$(dirname "$program")"
"$compiler" -O3 -std=c++14 -pthread ${CXXFLAGS:-} "$here/embree_peer.cpp" ${LDFLAGS:-} -lembree3 -o "$program"
echo "built: $program"
