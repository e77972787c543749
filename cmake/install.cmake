# Headers, library, program and what find_package(vdb_nns) needs.
include(CMakePackageConfigHelpers)
set(package_dir "${CMAKE_INSTALL_LIBDIR}/cmake/vdb_nns")

install(TARGETS vdb_nns vdb_nns_openvdb_bridge EXPORT vdb_nnsTargets)
set(VDB_NNS_CONFIG_NEEDS_CUDA FALSE)
if(NOT BUILD_SHARED_LIBS) # a shared vdb_nns has the device layer inside
    install(TARGETS vdb_nns_kernels EXPORT vdb_nnsTargets)
    set(VDB_NNS_CONFIG_NEEDS_CUDA ${VDB_NNS_CUDA_BUILD})
endif()
if(TARGET vdb_nns_cli)
    install(TARGETS vdb_nns_cli)
    install(DIRECTORY "${PROJECT_BINARY_DIR}/share/vdb_nns" DESTINATION "${CMAKE_INSTALL_DATADIR}")
endif()
install(DIRECTORY "${PROJECT_SOURCE_DIR}/include/vdb_nns" "${PROJECT_BINARY_DIR}/generated/include/vdb_nns"
    DESTINATION "${CMAKE_INSTALL_INCLUDEDIR}" FILES_MATCHING PATTERN "*.h")

install(EXPORT vdb_nnsTargets NAMESPACE vdb_nns:: DESTINATION "${package_dir}")
get_target_property(VDB_NNS_OPENVDB_ROOT OpenVDB::openvdb INTERFACE_INCLUDE_DIRECTORIES)
list(GET VDB_NNS_OPENVDB_ROOT 0 VDB_NNS_OPENVDB_ROOT)
cmake_path(GET VDB_NNS_OPENVDB_ROOT PARENT_PATH VDB_NNS_OPENVDB_ROOT)
configure_package_config_file("${PROJECT_SOURCE_DIR}/cmake/vdb_nnsConfig.cmake.in"
    "${PROJECT_BINARY_DIR}/vdb_nnsConfig.cmake" INSTALL_DESTINATION "${package_dir}")
write_basic_package_version_file("${PROJECT_BINARY_DIR}/vdb_nnsConfigVersion.cmake"
    COMPATIBILITY SameMinorVersion)
install(FILES "${PROJECT_BINARY_DIR}/vdb_nnsConfig.cmake" "${PROJECT_BINARY_DIR}/vdb_nnsConfigVersion.cmake"
    "${PROJECT_SOURCE_DIR}/cmake/FindOpenVDB.cmake" "${PROJECT_SOURCE_DIR}/cmake/FindBlosc.cmake"
    "${PROJECT_SOURCE_DIR}/cmake/FindLibdeflate.cmake"
    DESTINATION "${package_dir}")
install(FILES "${PROJECT_SOURCE_DIR}/LICENSE" DESTINATION "${CMAKE_INSTALL_DATADIR}/doc/vdb_nns")
