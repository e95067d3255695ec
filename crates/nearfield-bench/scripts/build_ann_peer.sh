#!/bin/sh
# Builds the libann program that `nearfield-bench baselines --ann PROGRAM` measures:
#
#   crates/nearfield-bench/scripts/build_ann_peer.sh [PROGRAM]
#
# PROGRAM is target/ann_peer by default. Needs a C++ compiler and libann's header (Debian: libann-dev); without them it says
# so and ends with 0, as the baseline is one that may be left out. CXXFLAGS and LDFLAGS are taken over.
set -eu
here=$(cd "$(dirname "$0")" && pwd)
program=${1:-target/ann_peer}
compiler=${CXX:-c++}
if ! command -v "$compiler" > /dev/null; then
    echo "skipped: no C++ compiler ($compiler); libann is left out"
    exit 0
fi
if ! printf '#include <ANN/ANN.h>\n' | "$compiler" ${CXXFLAGS:-} -x c++ -fsyntax-only - 2> /dev/null; then
    echo "skipped: no ANN/ANN.h (Debian: apt-get install libann-dev); libann is left out"
    exit 0
fi
mkdir -p "$(dirname "$program")"
"$compiler" -O3 -std=c++14 ${CXXFLAGS:-} "$here/ann_peer.cpp" ${LDFLAGS:-} -lann -o "$program"
echo "built: $program"
