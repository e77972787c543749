# cmake -C tools/build/tsan.cmake: ThreadSanitizer. The system's TBB is not instrumented, so what happens inside it
# must be hidden: TSAN_OPTIONS=suppressions=<here>/tsan.supp ctest -L asan
set(CMAKE_BUILD_TYPE RelWithDebInfo CACHE STRING "")
set(CMAKE_CXX_FLAGS_RELWITHDEBINFO "-O1 -g1" CACHE STRING "")
set(CMAKE_CXX_FLAGS "-fsanitize=thread" CACHE STRING "")
set(VDB_NNS_CUDA OFF CACHE STRING "")
set(VDB_NNS_BUILD_TESTS ON CACHE BOOL "")
