# A stranger's project: installs this build, copies the samples away, builds them against the install, and runs them.
set(prefix "${WORK_DIR}/consumer/prefix")
set(samples "${WORK_DIR}/consumer/samples")
set(build "${WORK_DIR}/consumer/build")
file(REMOVE_RECURSE "${WORK_DIR}/consumer")
file(COPY "${SOURCE_DIR}/samples" DESTINATION "${WORK_DIR}/consumer")

function(run)
    execute_process(COMMAND ${ARGN} RESULT_VARIABLE status OUTPUT_VARIABLE out ERROR_VARIABLE out)
    if(NOT status EQUAL 0)
        list(JOIN ARGN " " command)
        message(FATAL_ERROR "${command}\nfailed:\n${out}")
    endif()
endfunction()

run("${CMAKE_COMMAND}" --install "${BUILD_DIR}" --prefix "${prefix}")
# Unoptimised: what is tested is the package. The sanitizers' flags, if any, must be the library's.
run("${CMAKE_COMMAND}" -S "${samples}" -B "${build}" -G "${GENERATOR}" "-DCMAKE_CXX_COMPILER=${CXX}"
    "-DCMAKE_CXX_FLAGS=${CXX_FLAGS}" -DCMAKE_BUILD_TYPE=Debug "-DCMAKE_PREFIX_PATH=${prefix}")
run("${CMAKE_COMMAND}" --build "${build}")
run("${CMAKE_CTEST_COMMAND}" --test-dir "${build}" --output-on-failure --no-tests=error)
run("${prefix}/bin/vdb_nns" --version)
