# cmake -C tools/build/asan.cmake: AddressSanitizer and UndefinedBehaviorSanitizer, with casts of floating-point numbers that
# `undefined` leaves out; the first finding ends the test.
# Without the device layer: the CUDA runtime is not instrumented.
set(CMAKE_BUILD_TYPE RelWithDebInfo CACHE STRING "")
set(CMAKE_CXX_FLAGS_RELWITHDEBINFO "-O1 -g1" CACHE STRING "")
set(CMAKE_CXX_FLAGS "-fsanitize=address,undefined,float-cast-overflow -fno-sanitize-recover=all -fno-omit-frame-pointer" CACHE STRING "")
set(VDB_NNS_CUDA OFF CACHE STRING "")
set(VDB_NNS_BUILD_TESTS ON CACHE BOOL "")
