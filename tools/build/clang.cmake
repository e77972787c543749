# cmake -C tools/build/clang.cmake: clang++, vdb_nns as a shared library, no optimisation (what
# is tested is that it compiles and links).
set(CMAKE_CXX_COMPILER clang++ CACHE STRING "")
set(CMAKE_BUILD_TYPE Debug CACHE STRING "")
set(CMAKE_CXX_FLAGS_DEBUG "-O0" CACHE STRING "")
set(BUILD_SHARED_LIBS ON CACHE BOOL "")
set(VDB_NNS_CUDA OFF CACHE STRING "")
set(VDB_NNS_BUILD_TESTS ON CACHE BOOL "")
