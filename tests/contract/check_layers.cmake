# The layers of src/ARCHITECTURE.md, as far as #include lines show them.
function(forbid pattern why)
    foreach(file IN LISTS ARGN)
        file(STRINGS "${file}" lines REGEX "${pattern}")
        if(lines)
            file(RELATIVE_PATH name "${SOURCE_DIR}" "${file}")
            message(SEND_ERROR "${name}: ${why}: ${lines}")
        endif()
    endforeach()
endfunction()

set(openvdb "# *include *[<\"](openvdb|nanovdb)/")
set(host "# *include *[<\"](tbb|oneapi|boost|Eigen)/")
set(device "# *include *[<\"](cuda[_.a-z0-9]*|cub|thrust|cuda/std)[/>\"]|__global__|__device__")

file(GLOB public "${SOURCE_DIR}/include/vdb_nns/*")
forbid("${host}|${device}" "a public header needs the standard library alone" ${public})
list(FILTER public EXCLUDE REGEX "openvdb_bridge\\.h$")
forbid("${openvdb}" "only the bridge header may include OpenVDB" ${public})

file(GLOB_RECURSE kernels "${SOURCE_DIR}/kernels/*")
forbid("${openvdb}|${host}" "kernels know neither OpenVDB nor TBB" ${kernels})
file(GLOB_RECURSE shared "${SOURCE_DIR}/kernels/shared/*")
list(FILTER shared EXCLUDE REGEX "annotation\\.h$")
forbid("${device}" "kernels/shared is C++ that any compiler reads" ${shared})

file(GLOB_RECURSE source "${SOURCE_DIR}/src/*.cpp" "${SOURCE_DIR}/src/*.h")
forbid("__global__|__device__|cuda_runtime" "src has no device code" ${source})
forbid("std::(abort|exit|terminate) *\\(|[^a-z_]exit *\\(|std::c(out|err)|[^a-zA-Z_]f?printf *\\("
    "the library never prints and never exits" ${source})

file(GLOB_RECURSE tools "${SOURCE_DIR}/tools/vdb_nns/*.cpp" "${SOURCE_DIR}/tools/vdb_nns/*.h")
forbid("# *include *[<\"](\\.\\./)*(src/|particles/|grid/|estimate/|workload/|schedule/|execute/|lists/|output/|scene/|util/)"
    "tools call only the public headers" ${tools})
list(FILTER tools EXCLUDE REGEX "/bench/")
forbid("# *include *\"(shared|cuda)/" "tools call only the public headers" ${tools})
