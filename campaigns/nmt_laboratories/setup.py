from setuptools import find_packages, setup

setup(
    name="nmt_laboratories",
    version="0.4.0",
    packages=find_packages(exclude=["test"]),
    package_data={"": ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/nmt_laboratories"]),
        ("share/nmt_laboratories", ["package.xml"]),
    ],
    install_requires=[
        "joblib>=1.3",
        "mujoco>=3.3.7",
        "numba>=0.59",
        "numpy>=1.26",
        "PyYAML>=6.0",
        "ruamel.yaml>=0.17.21",
        "scikit-fem>=10.0",
        "scipy>=1.11",
    ],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    maintainer="nmt developers",
    maintainer_email="nmt@example.org",
    description="Simulated laboratories for the diagnosis, and campaigns over their seeds",
    license="Apache-2.0",
)
