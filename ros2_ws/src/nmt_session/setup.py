from setuptools import find_packages, setup

setup(
    name="nmt_session",
    version="0.4.0",
    packages=find_packages(exclude=["test"]),
    package_data={"": ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/nmt_session"]),
        ("share/nmt_session", ["package.xml"]),
    ],
    install_requires=[
        "numpy>=1.26",
    ],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    maintainer="nmt developers",
    maintainer_email="nmt@example.org",
    description="A test in one process without ROS, and what each node is given",
    license="Apache-2.0",
)
