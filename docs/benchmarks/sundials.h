/* What CVODE and IDA share: machine code of ours as they call it, and vectors and dense matrices of SUNDIALS.
 *
 * The symbols of SUNDIALS 7 are those of libraries that are loaded already; its headers are not needed, for all that
 * is passed are pointers, doubles and int: SUNComm without MPI, and sunindextype as scikit-sundae has it. */
#include <stdint.h>

typedef int32_t (*kernel)(double t, const double *y, const double *prepared, double *out);

int SUNContext_Create(int, void **);
int SUNContext_Free(void **);
void *N_VMake_Serial(int, double *, void *);
double *N_VGetArrayPointer(void *);
void N_VDestroy(void *);
void *SUNDenseMatrix(int, int, void *);
double *SUNDenseMatrix_Data(void *);
void SUNMatDestroy(void *);
void *SUNLinSol_Dense(void *, void *, void *);
int SUNLinSolFree(void *);
