# Option values that are offered hold, and those that are not fail, at configure time, with the reason.
function(configure name expected text)
    set(build "${WORK_DIR}/options/${name}")
    file(REMOVE_RECURSE "${build}")
    execute_process(
        COMMAND "${CMAKE_COMMAND}" -S "${SOURCE_DIR}" -B "${build}" -G "${GENERATOR}" "-DCMAKE_CXX_COMPILER=${CXX}"
                "-DCMAKE_CXX_FLAGS=${CXX_FLAGS}" -DVDB_NNS_BUILD_TESTS=OFF ${ARGN}
        RESULT_VARIABLE status OUTPUT_VARIABLE out ERROR_VARIABLE out)
    string(REGEX REPLACE "[ \n]+" " " flat "${out}")
    if((expected STREQUAL "works" AND NOT status EQUAL 0) OR (expected STREQUAL "fails" AND status EQUAL 0))
        message(SEND_ERROR "${name}: should have been a configure that ${expected}:\n${out}")
    elseif(NOT flat MATCHES "${text}")
        message(SEND_ERROR "${name}: '${text}' is not in the output:\n${out}")
    endif()
endfunction()

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
