MODULE Palletising(NOSTEPIN)
    ! ***  points  ***
    TASK PERS tooldata gun:=[TRUE,[[97.4,0,223.1],[0.924,0,0.383,0]],[5,[23,0,75],[1,0,0,0],0,0,0]];
    LOCAL PERS wobjdata fixture:=[FALSE,TRUE,"",[[300,600,200],[1,0,0,0]],[[0,200,30],[0.7071068,0,0,0.7071068]]];
    CONST robtarget pPick:=<4|gun|fixture>;
    CONST robtarget pPlace{2,2}:=[[<5|gun|fixture>,<6|gun|fixture>],[<7|gun|fixture>,<8|gun|fixture>]];
    CONST num high:=2*60;
    VAR num n:=0;
    PROC pick()
        MoveJ Offs(pPick,0,0,high),v1500,z10,gun\WObj:=fixture;
        MoveL pPick,v200,fine,gun\WObj:=fixture;
        SetDO grip,1;
        MoveL Offs(pPick,0,-5,high/2),v500,z10,gun\WObj:=fixture;
        TEST n
        CASE 0:
            MoveL pPlace{1,1},v200,fine,gun\WObj:=fixture;
        CASE 1,2:
            MoveL pPlace{1,2},v200,fine,gun\WObj:=fixture;
        DEFAULT:
            MoveL pPlace{2,2},v200,fine,gun\WObj:=fixture;
        ENDTEST
        Incr n;
    ERROR
        IF ERRNO=ERR_WAIT_MAXTIME THEN
            TPWrite "MoveL pPick := [[1,2,3]]";
            RETRY;
        ENDIF
    ENDPROC
ENDMODULE
