# Finds OpenVDB: by its own package configuration where there is one (from version 14 on), else by its header and library, as
# the find module that distributions ship beside it insists on components that they do not have. It is installed with this
# project, for consumers.
#
# Target:    OpenVDB::openvdb
# Variables: OpenVDB_FOUND, OpenVDB_VERSION
# Hint:      OpenVDB_ROOT

find_package(OpenVDB CONFIG QUIET)
if(TARGET OpenVDB::openvdb)
    include(FindPackageHandleStandardArgs)
    find_package_handle_standard_args(OpenVDB CONFIG_MODE)
    return()
endif()

find_path(OpenVDB_INCLUDE_DIR openvdb/version.h)
find_library(OpenVDB_LIBRARY openvdb)
mark_as_advanced(OpenVDB_INCLUDE_DIR OpenVDB_LIBRARY)

set(OpenVDB_VERSION "")
if(OpenVDB_INCLUDE_DIR)
    file(STRINGS "${OpenVDB_INCLUDE_DIR}/openvdb/version.h" _vdb_nns_lines REGEX "#define OPENVDB_")
    foreach(_vdb_nns_part MAJOR MINOR PATCH)
        if("${_vdb_nns_lines}" MATCHES "OPENVDB_LIBRARY_${_vdb_nns_part}_VERSION_NUMBER +([0-9]+)")
            list(APPEND OpenVDB_VERSION ${CMAKE_MATCH_1})
        endif()
    endforeach()
    list(JOIN OpenVDB_VERSION "." OpenVDB_VERSION)
endif()

find_package(TBB CONFIG QUIET)

include(FindPackageHandleStandardArgs)
find_package_handle_standard_args(OpenVDB
    REQUIRED_VARS OpenVDB_LIBRARY OpenVDB_INCLUDE_DIR TBB_FOUND
    VERSION_VAR OpenVDB_VERSION)

if(OpenVDB_FOUND AND NOT TARGET OpenVDB::openvdb)
    add_library(OpenVDB::openvdb UNKNOWN IMPORTED)
    set_target_properties(OpenVDB::openvdb PROPERTIES IMPORTED_LOCATION "${OpenVDB_LIBRARY}")
    target_include_directories(OpenVDB::openvdb INTERFACE "${OpenVDB_INCLUDE_DIR}")
    target_link_libraries(OpenVDB::openvdb INTERFACE TBB::tbb)
    # Built with Imath's half, OpenVDB's headers use it; its conversion table is in libImath. (Imath's own package
    # configuration wants the files of packages that nobody installed.)
    if("${_vdb_nns_lines}" MATCHES "#define OPENVDB_USE_IMATH_HALF")
        find_library(OpenVDB_IMATH_LIBRARY NAMES Imath Imath-3_2 Imath-3_1)
        find_path(OpenVDB_IMATH_INCLUDE_DIR Imath/half.h)
        mark_as_advanced(OpenVDB_IMATH_LIBRARY OpenVDB_IMATH_INCLUDE_DIR)
        if(OpenVDB_IMATH_LIBRARY AND OpenVDB_IMATH_INCLUDE_DIR)
            target_include_directories(OpenVDB::openvdb INTERFACE "${OpenVDB_IMATH_INCLUDE_DIR}")
            target_link_libraries(OpenVDB::openvdb INTERFACE "${OpenVDB_IMATH_LIBRARY}")
        endif()
    endif()
endif()
