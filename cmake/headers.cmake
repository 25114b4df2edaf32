# The header-only C++ core as a CMake package: find_package(gainroom), then link to gainroom::gainroom. In a wheel it is beside the headers there.
include(CMakePackageConfigHelpers)

add_library(gainroom INTERFACE)
add_library(gainroom::gainroom ALIAS gainroom)
target_compile_features(gainroom INTERFACE cxx_std_17)
# The same digits on every machine, as in the Python module.
target_compile_options(gainroom INTERFACE $<$<CXX_COMPILER_ID:GNU,Clang,AppleClang>:-ffp-contract=off>)
target_include_directories(gainroom INTERFACE $<BUILD_INTERFACE:${PROJECT_SOURCE_DIR}/${NATIVE}/include> $<INSTALL_INTERFACE:include>)

set(CONFIG share/gainroom/cmake)
if(SKBUILD)
  set(CONFIG gainroom/native/cmake)
  set_property(TARGET gainroom PROPERTY INTERFACE_INCLUDE_DIRECTORIES $<INSTALL_INTERFACE:gainroom/native/include>)
else()
  install(DIRECTORY ${NATIVE}/include/ DESTINATION include)
  # Where colcon and ros2 look for a package.
  file(TOUCH "${PROJECT_BINARY_DIR}/gainroom")
  install(FILES package.xml DESTINATION share/gainroom)
  install(FILES "${PROJECT_BINARY_DIR}/gainroom" DESTINATION share/ament_index/resource_index/packages)
endif()

write_basic_package_version_file("${PROJECT_BINARY_DIR}/gainroomConfigVersion.cmake" COMPATIBILITY SameMinorVersion ARCH_INDEPENDENT)
install(TARGETS gainroom EXPORT gainroom)
install(EXPORT gainroom NAMESPACE gainroom:: FILE gainroomConfig.cmake DESTINATION ${CONFIG})
install(FILES "${PROJECT_BINARY_DIR}/gainroomConfigVersion.cmake" DESTINATION ${CONFIG})
