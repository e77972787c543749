# Option values that are offered hold, and those that are not fail, at configure time, with the reason.
function(configure name expected text)
    set(build "${WORK_DIR}/options/${name}")
    file(REMOVE_RECURSE "${build}")
    execute_process(
        COMMAND "${CMAKE_COMMAND}" -S "${SOURCE_DIR}" -B "${build}" -G "${GENERATOR}" "-DCMAKE_CXX_COMPILER=${CXX}"
                "-DCMAKE_CXX_FLAGS=${CXX_FLAGS}" ${ARGN}
        RESULT_VARIABLE status OUTPUT_VARIABLE out ERROR_VARIABLE out)
    string(REGEX REPLACE "[ \n]+" " " flat "${out}")
    if((expected STREQUAL "works" AND NOT status EQUAL 0) OR (expected STREQUAL "fails" AND status EQUAL 0))
        message(SEND_ERROR "${name}: should have been a configure that ${expected}:\n${out}")
    elseif(NOT flat MATCHES "${text}")
        message(SEND_ERROR "${name}: '${text}' is not in the output:\n${out}")
    endif()
endfunction()

# Nobody who has not asked for tests needs what they need; who asks is told.
set(no_gtest -DVDB_NNS_CUDA=OFF -DCMAKE_DISABLE_FIND_PACKAGE_GTest=ON)
configure(tests_not_asked works "Configuring done" ${no_gtest})
configure(tests_without_gtest fails "tests need GTest::gtest_main.*tools/setup.sh --tests" ${no_gtest} -DVDB_NNS_BUILD_TESTS=ON)
file(STRINGS "${WORK_DIR}/options/tests_not_asked/CMakeCache.txt" strict REGEX "^VDB_NNS_WERROR:BOOL=OFF$")
if(NOT strict)
    message(SEND_ERROR "warnings are errors though nobody asked")
endif()

set(no_compiler "-DVDB_NNS_NVCC=/nonexistent/nvcc")
configure(cuda_bad fails "VDB_NNS_CUDA is 'YES'; it must be AUTO, ON or OFF" -DVDB_NNS_CUDA=YES)
configure(cuda_on_without fails "VDB_NNS_CUDA=ON, but CUDA cannot be built: no nvcc" -DVDB_NNS_CUDA=ON ${no_compiler})
configure(cuda_on_broken fails "VDB_NNS_CUDA=ON, but CUDA cannot be built: .* cannot compile"
    -DVDB_NNS_CUDA=ON "-DVDB_NNS_NVCC=/bin/false")
configure(cuda_auto_without works "CUDA: absent \\(no nvcc" -DVDB_NNS_CUDA=AUTO ${no_compiler})
configure(cuda_off works "CUDA: absent \\(VDB_NNS_CUDA=OFF\\)" -DVDB_NNS_CUDA=OFF)

# The stub is built even where this build has CUDA.
execute_process(COMMAND "${CMAKE_COMMAND}" --build "${WORK_DIR}/options/cuda_off" --target vdb_nns_kernels
    RESULT_VARIABLE status OUTPUT_VARIABLE out ERROR_VARIABLE out)
if(NOT status EQUAL 0)
    message(SEND_ERROR "the stub does not build:\n${out}")
endif()
